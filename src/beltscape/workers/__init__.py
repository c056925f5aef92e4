"""Independent tasks on several workers: in this process, or on a Ray cluster of one machine or many.

`tasks` has the entry points, `run_tasks`, `open_pool` and `collect_values`; `options` choose the workers;
`ray_cluster` runs the tasks on workers, each of which runs a task by `call`.
"""
