"""Tasks in this process, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from typing import Any

from beltscape.workers.call import Completed, call


def run_here(
    function: Callable[[Any, Any], Any], shared: Any, tasks: Sequence[Any]
) -> Generator[Completed[Any]]:
    """Yield the end of every task, in their order; see `tasks.run_tasks`."""
    for number, task in enumerate(tasks):
        yield call(function, shared, number, task)
