"""Independent tasks with one function, and the door through which they are run."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from beltscape.core.errors import SettingsError

Shared = TypeVar("Shared")
Arguments = TypeVar("Arguments")
Value = TypeVar("Value")
Value_co = TypeVar("Value_co", covariant=True)

MOST_WORKERS = 4096
"""More workers than one driver can feed: Ray hands out some thousand tasks a second."""


@dataclass(frozen=True, slots=True)
class WorkerOptions:
    """Where tasks run."""

    workers: int | None = None
    """Largest number of tasks at a time; None: one without an address, else as many as the cluster has cores."""
    address: str | None = None
    """A Ray cluster: "auto", "host:port" or "ray://host:port"; None: this machine."""

    def __post_init__(self) -> None:
        if self.workers is not None and not 1 <= self.workers <= MOST_WORKERS:
            raise SettingsError(f"--workers {self.workers}: must be between 1 and {MOST_WORKERS}")

    @property
    def is_here(self) -> bool:
        """Return whether the tasks run in this process, one after the other."""
        return self.address is None and self.workers in (None, 1)


@dataclass(frozen=True, slots=True)
class Completed(Generic[Value_co]):
    """The end of one task."""

    number: int
    """Index of the task."""
    value: Value_co | None
    """What the function returned; None if it failed."""
    failure: str
    """Why there is no value, in one line; empty where there is one."""
    worker: str
    """Machine and process that ran it."""
    begin_s: float
    """System clock at its begin, s since 1970."""
    seconds: float
    """Time that it took."""


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
        from beltscape.workers.here import run_here

        return run_here(function, shared, tasks)
    from beltscape.workers.ray_cluster import run_on_ray

    return run_on_ray(function, shared, tasks, options, describe)
