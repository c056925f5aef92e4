"""Independent tasks on several workers: in this process, on processes of this machine, or on a Ray cluster.

`tasks` has the entry points, `run_tasks`, `open_pool` and `collect_values`; `options` choose the workers;
`ray_cluster` runs the tasks on workers, each of which runs a task by `call`.
"""
