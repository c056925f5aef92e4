"""Tasks on a Ray cluster: one that runs already, or one of this machine that ends with the tasks."""

from __future__ import annotations

import socket
from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from beltscape import __version__
from beltscape.core.errors import SettingsError
from beltscape.workers.call import call
from beltscape.workers.tasks import Completed, WorkerOptions

_RETRIES = 10
"""Number of deaths of its worker after which a task is given up: by then the task kills the worker, not chance."""
_AHEAD = 2
"""Tasks handed out for each worker: one runs and one waits beside it, so that no worker waits for the driver."""
_ANSWER_S = 5.0
"""Time in which a cluster's port must answer."""
_POLL_S = 1.0
"""Time after which the cluster's size is looked at again."""


def run_on_ray(
    function: Callable[[Any, Any], Any],
    shared: Any,
    tasks: Sequence[Any],
    options: WorkerOptions,
    describe: Callable[[Any], str],
) -> Generator[Completed[Any]]:
    """Yield the ends of the tasks in the order in which they come; see `tasks.run_tasks`."""
    with _connect(options) as ray:
        remote = ray.remote(num_cpus=1, max_retries=_RETRIES, retry_exceptions=False)(_call_on_worker)
        everywhere, waiting = ray.put((__version__, function, shared)), deque(enumerate(tasks))
        running: dict[Any, int] = {}
        try:
            while waiting or running:
                while waiting and len(running) < _AHEAD * _count_workers(ray, options):
                    number, task = waiting.popleft()
                    running[remote.options(name=describe(task)).remote(everywhere, number, task)] = number
                for reference in ray.wait(list(running), num_returns=1, timeout=_POLL_S)[0]:
                    yield _get_end(ray, reference, running.pop(reference))
        finally:
            for reference in running:
                ray.cancel(reference, force=True)


def _call_on_worker(everywhere: tuple[str, Any, Any], number: int, task: Any) -> Completed[Any]:
    """Run a task on a worker that has the driver's version of the program."""
    version, function, shared = everywhere
    if version != __version__:
        raise SettingsError(
            f"a worker has Beltscape {__version__}, this machine has {version}; install one version on all"
        )
    return call(function, shared, number, task)


def _get_end(ray: Any, reference: Any, number: int) -> Completed[Any]:
    """Return the end of a task that was run, or whose workers died."""
    try:
        return ray.get(reference)
    except (
        ray.exceptions.RayTaskError
    ) as error:  # the function's own failures are values: this is the call around it
        raise SettingsError(str(error.cause).splitlines()[0]) from error
    except ray.exceptions.RayError as error:
        kind = type(error).__name__
        return Completed(number, None, f"its worker died {_RETRIES + 1} times ({kind})", "", 0.0, 0.0)


def _count_workers(ray: Any, options: WorkerOptions) -> int:
    """Return the present number of workers; nodes come and go."""
    cores = int(ray.cluster_resources().get("CPU", 1))
    return max(1, cores if options.workers is None else min(cores, options.workers))


def _silence(ray: Any) -> None:
    """Keep Ray from printing on standard output, which belongs to the result."""
    ray._private.worker._worker_logs_enabled = False


def _probe(address: str | None) -> None:
    """Raise OSError if nothing listens at host:port; Ray itself would try for minutes."""
    host, separator, port = (address or "").removeprefix("ray://").rpartition(":")
    if separator and port.isdigit():
        socket.create_connection((host, int(port)), _ANSWER_S).close()


@contextmanager
def _connect(options: WorkerOptions) -> Generator[Any]:
    """Connect to the cluster, or start one of this machine; both are left at the end."""
    try:
        ray: Any = import_module("ray")
    except ImportError as error:
        raise SettingsError(
            "several workers need Ray, which is not installed; pip install 'beltscape[cluster]', or leave out "
            "--workers and --address"
        ) from error
    _silence(ray)
    if ray.is_initialized():
        yield ray
        return
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    try:
        _probe(options.address)
        if options.address is None:
            ray.init(address="local", num_cpus=options.workers, include_dashboard=False, **quiet)
        else:
            ray.init(address=options.address, **quiet)
    except (ConnectionError, OSError, RuntimeError, ValueError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise SettingsError(
            f"--address {options.address}: no Ray cluster answers ({reason}); start one with ray start --head"
        ) from error
    try:
        yield ray
    finally:
        ray.shutdown()
