"""Independent tasks on several workers: in this process, or on a Ray cluster of one machine or many.

`tasks` has the two entry points, `run_tasks` and `open_pool`; `collecting` is for tasks that must all succeed;
`options` choose the workers; `here` and `ray_cluster` run the tasks; a worker calls a task by `call`, on one `core`.
"""
