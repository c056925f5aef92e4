"""One call of a task's function, on whichever worker, with its time and its failure; and tasks in this process."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from beltscape.core.errors import BeltscapeError

Value_co = TypeVar("Value_co", covariant=True)


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


def call(function: Callable[[Any, Any], Any], shared: Any, number: int, task: Any) -> Completed[Any]:
    """Run a task; its exception becomes its failure in one line."""
    begin_s, clock_s = time.time(), time.perf_counter()
    value, failure = None, ""
    try:
        value = function(shared, task)
    except BeltscapeError as error:
        failure = str(error)
    except Exception as error:
        failure = f"{type(error).__name__}: {error}".splitlines()[0]
    worker = f"{socket.gethostname()}/{os.getpid()}"
    return Completed(number, value, failure, worker, begin_s, time.perf_counter() - clock_s)


def run_here(
    function: Callable[[Any, Any], Any], shared: Any, tasks: Sequence[Any]
) -> Generator[Completed[Any]]:
    """Yield the end of every task, in their order; see `tasks.run_tasks`."""
    for number, task in enumerate(tasks):
        yield call(function, shared, number, task)
