"""Independent tasks on several workers: in this process, or on a Ray cluster of one machine or many.

`tasks` has the vocabulary and the doors, `run_tasks` and `open_pool`; `collecting` is for tasks that must all
succeed; `here` and `ray_cluster` are the two engines behind them.
"""
