"""Independent tasks of one function, and the functions that run them on workers."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import AbstractContextManager
from typing import Protocol, TypeVar

from beltscape.workers.call import Completed
from beltscape.workers.here import run_here
from beltscape.workers.options import WorkerOptions

Shared = TypeVar("Shared")
Arguments = TypeVar("Arguments")
Arguments_contra = TypeVar("Arguments_contra", contravariant=True)
Value = TypeVar("Value")
Value_co = TypeVar("Value_co", covariant=True)


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
        When several workers are wanted and Ray is not installed, or the cluster does not answer.
    """
    if options.is_here:
        return run_here(function, shared, tasks)
    from beltscape.workers.ray_cluster import run_on_ray

    return run_on_ray(function, shared, tasks, options, describe)


class PendingTask(Protocol[Value_co]):
    """A task that was handed out."""

    def result(self) -> Completed[Value_co]:
        """Wait for the task's end and return it."""
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
    from beltscape.workers.ray_cluster import open_ray_pool

    return open_ray_pool(function, shared, options)
