"""Independent tasks of one function, run on workers: their ends as they come, or the values if all succeed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

from beltscape.core.errors import SettingsError
from beltscape.workers.call import Completed, run_here
from beltscape.workers.options import WorkerOptions
from beltscape.workers.processes import open_process_pool

Shared = TypeVar("Shared")
Arguments = TypeVar("Arguments")
Arguments_contra = TypeVar("Arguments_contra", contravariant=True)
Value = TypeVar("Value")
Value_co = TypeVar("Value_co", covariant=True)

_AHEAD = 2
"""Tasks handed out for each worker: one runs and one waits, so that no worker waits for the driver."""


def run_tasks(
    function: Callable[[Shared, Arguments], Value],
    shared: Shared,
    tasks: Sequence[Arguments],
    options: WorkerOptions,
    describe: Callable[[Arguments], str] = str,
) -> Generator[Completed[Value]]:
    """Run ``function(shared, task)`` for every task and yield the ends in the order in which they come.

    ``shared`` is sent to every machine once. A task whose worker dies is run again; an exception of the function is
    a failure of its task alone. Only few tasks wait at a worker, so that memory stays bounded. ``describe`` gives the
    name under which a cluster's dashboard shows a task. Closing the generator cancels the tasks that run.

    Raises
    ------
    SettingsError
        When the tasks are for a cluster and Ray is not installed, or the cluster does not answer.
    """
    if options.is_here:
        return run_here(function, shared, tasks)
    return run_in_pool(function, shared, tasks, options, describe)


def run_in_pool(
    function: Callable[[Shared, Arguments], Value],
    shared: Shared,
    tasks: Sequence[Arguments],
    options: WorkerOptions,
    describe: Callable[[Arguments], str],
) -> Generator[Completed[Value]]:
    """Yield the ends of tasks on several workers, no more than there are tasks; see `run_tasks`."""
    most = None if options.workers is None else max(1, min(options.workers, len(tasks)))
    with open_pool(function, shared, replace(options, workers=most)) as pool:
        waiting, running = deque(tasks), list[PendingTask[Value]]()
        while waiting or running:
            while waiting and len(running) < _AHEAD * pool.workers:
                task = waiting.popleft()
                running.append(pool.submit(task, describe(task)))
            ended = pool.wait(running)
            running = [one for one in running if one not in ended]
            for one in ended:
                yield one.result()


class PendingTask(Protocol[Value_co]):
    """A task that was handed out."""

    def result(self) -> Completed[Value_co]:
        """Wait for the task's end and return it."""
        ...

    def done(self) -> bool:
        """Return whether the task has ended."""
        ...


class TaskPool(Protocol[Arguments_contra, Value_co]):
    """Workers that take tasks of one function one by one; their number is the caller's to bound."""

    @property
    def workers(self) -> int:
        """Return the present number of workers."""
        ...

    def submit(self, task: Arguments_contra, name: str) -> PendingTask[Value_co]:
        """Hand out a task; ``name`` is the one under which a cluster's dashboard shows it."""
        ...

    def wait(self, pending: Sequence[Any]) -> list[Any]:
        """Wait for the end of one of these tasks of the pool, or a while; return those that have ended."""
        ...


def open_pool(
    function: Callable[[Shared, Arguments], Value], shared: Shared, options: WorkerOptions
) -> AbstractContextManager[TaskPool[Arguments, Value]]:
    """Return workers for tasks that become known one after the other; what runs at the end is cancelled.

    Otherwise as `run_tasks`. For tasks in this process there is no pool.

    Raises
    ------
    SettingsError
        When Ray is not installed, or the cluster does not answer.
    """
    if options.address is None:
        assert options.workers is not None
        return open_process_pool(function, shared, options.workers)
    from beltscape.workers.ray_cluster import open_ray_pool

    return open_ray_pool(function, shared, options)


def collect_values(
    function: Callable[[Shared, Arguments], Value],
    shared: Shared,
    tasks: Sequence[Arguments],
    options: WorkerOptions,
    on_end: Callable[[int], None],
) -> list[Value]:
    """Return ``function(shared, task)`` for every task; ``on_end`` receives the number of tasks that have ended.

    Raises
    ------
    Exception
        The one that the function raised for a task; the other tasks are cancelled.
    SettingsError
        When the workers of a task died.
    """
    found: dict[int, Value] = {}
    on_end(0)
    for end in run_tasks(_Catching(function), shared, tasks, options):
        if end.value is None:
            raise SettingsError(f"--workers: {end.failure}; use fewer workers, which takes less memory")
        if isinstance(end.value, Exception):
            raise end.value
        found[end.number] = end.value.value
        on_end(len(found))
    return [found[number] for number in range(len(tasks))]


@dataclass(frozen=True, slots=True, eq=False)
class _Returned(Generic[Value]):
    """The value that a function returned, which may be None."""

    value: Value


@dataclass(frozen=True, slots=True, eq=False)
class _Catching(Generic[Shared, Arguments, Value]):
    """A function that returns the error that it would raise, so that its type survives the way from a worker."""

    function: Callable[[Shared, Arguments], Value]

    def __call__(self, shared: Shared, task: Arguments) -> _Returned[Value] | Exception:
        """Return what the function returns or raises."""
        try:
            return _Returned(self.function(shared, task))
        except Exception as error:
            return error
