"""Independent tasks on several workers: in this process, or on a Ray cluster of one machine or many.

`tasks` has the vocabulary and `run_tasks`, the only door; `here` and `ray_cluster` are the two engines behind it.
"""
