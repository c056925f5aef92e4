"""Independent tasks on several workers: in this process, or on a Ray cluster of one machine or many.

`tasks` has the types and the two entry points, `run_tasks` and `open_pool`; `collecting` is for tasks that must all
succeed; `here` and `ray_cluster` run them; a worker calls a task by `call`, on one `core`.
"""
