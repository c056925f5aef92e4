"""The values of tasks that must all succeed, in the tasks' order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic

from beltscape.core.errors import SettingsError
from beltscape.workers.options import WorkerOptions
from beltscape.workers.tasks import Arguments, Shared, Value, run_tasks


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
