"""Tasks on a Ray cluster: one that runs already, or one of this machine that ends with the tasks."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from typing import Any

from beltscape import __version__
from beltscape.core.errors import SettingsError
from beltscape.workers.call import Completed, call
from beltscape.workers.core import take_core
from beltscape.workers.options import WorkerOptions
from beltscape.workers.ray_connection import connect

_RETRIES = 10
"""Number of deaths of its worker after which a task is given up: by then the task kills the worker, not chance."""
_AHEAD = 2
"""Tasks handed out for each worker: one runs and one waits beside it, so that no worker waits for the driver."""
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
    with open_ray_pool(function, shared, options) as pool:
        waiting = deque(tasks)
        while waiting or pool.running:
            while waiting and len(pool.running) < _AHEAD * pool.workers:
                task = waiting.popleft()
                pool.submit(task, describe(task))
            yield from pool.wait(_POLL_S)


@contextmanager
def open_ray_pool(
    function: Callable[[Any, Any], Any], shared: Any, options: WorkerOptions
) -> Generator[RayPool]:
    """Yield a pool of a cluster's workers; see `tasks.open_pool`."""
    with connect(options) as ray:
        pool = RayPool(ray, function, shared, options)
        try:
            yield pool
        finally:
            for reference in pool.running:
                ray.cancel(reference, force=True)


class RayPool:
    """Runs the tasks of one function on the workers of a cluster."""

    def __init__(
        self, ray: Any, function: Callable[[Any, Any], Any], shared: Any, options: WorkerOptions
    ) -> None:
        self._ray, self._options, self._count = ray, options, 0
        self._remote = ray.remote(num_cpus=1, max_retries=_RETRIES, retry_exceptions=False)(_call_on_worker)
        self._everywhere = ray.put((__version__, function, shared))
        self.running: dict[Any, int] = {}
        """Reference → number of every task whose end was not taken yet."""

    @property
    def workers(self) -> int:
        """Return the present number of workers; nodes come and go."""
        cores, most = int(self._ray.cluster_resources().get("CPU", 1)), self._options.workers
        return max(1, cores if most is None else min(cores, most))

    def submit(self, task: Any, name: str) -> _RayTask:
        """Hand out a task; see `tasks.TaskPool`."""
        reference = self._remote.options(name=name).remote(self._everywhere, self._count, task)
        self.running[reference] = self._count
        self._count += 1
        return _RayTask(self, reference)

    def wait(self, seconds: float) -> Generator[Completed[Any]]:
        """Yield the end of a task that ends within a time; nothing if none does."""
        for reference in self._ray.wait(list(self.running), num_returns=1, timeout=seconds)[0]:
            yield self.take(reference)

    def take(self, reference: Any) -> Completed[Any]:
        """Wait for the end of a task that was run, or whose workers died."""
        number = self.running.pop(reference)
        try:
            return self._ray.get(reference)
        except self._ray.exceptions.RayTaskError as error:
            # the function's own failures are values: this is the call around it
            raise SettingsError(str(error.cause).splitlines()[0]) from error
        except self._ray.exceptions.RayError as error:
            has_crashed = isinstance(error, self._ray.exceptions.WorkerCrashedError)
            what = f"its worker died {_RETRIES + 1} times" if has_crashed else "the cluster was lost"
            return Completed(number, None, f"{what} ({type(error).__name__})", "", 0.0, 0.0)


class _RayTask:
    """A task of a pool."""

    def __init__(self, pool: RayPool, reference: Any) -> None:
        self._pool, self._reference = pool, reference

    def result(self) -> Completed[Any]:
        """Return the task's end; see `tasks.PendingTask`."""
        return self._pool.take(self._reference)


def _call_on_worker(everywhere: tuple[str, Any, Any], number: int, task: Any) -> Completed[Any]:
    """Run a task on a worker that has the driver's version of the program, on one core."""
    version, function, shared = everywhere
    if version != __version__:
        raise SettingsError(
            f"a worker has Beltscape {__version__}, this machine has {version}; install one version on all"
        )
    take_core()
    return call(function, shared, number, task)
