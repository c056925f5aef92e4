"""Independent tasks on several workers: in this process, on processes of this machine, or on a Ray cluster.

`tasks` has the entry points, `run_tasks`, `open_pool` and `collect_values`; `options` choose the workers;
`processes` and `ray_cluster` run the tasks on workers, each of which runs a task by `call`. `transport` brings
objects to a process; `worker_process` is that process. `calls` has a pool's processes make single calls beside
those that run tasks.
"""
