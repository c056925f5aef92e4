"""An engine for tasks in place of a pool's: last task first, everything pickled as on its way to another machine."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Generator, Sequence
from typing import Any

from beltscape.workers.call import Completed, call
from beltscape.workers.options import WorkerOptions


def run_backwards(
    function: Callable[[Any, Any], Any],
    shared: Any,
    tasks: Sequence[Any],
    options: WorkerOptions,
    describe: Callable[[Any], str],
) -> Generator[Completed[Any]]:
    """Yield the ends of the tasks, the last task's first; for ``beltscape.workers.tasks.run_in_pool``."""
    del options, describe
    for number, task in reversed([*enumerate(tasks)]):
        there = pickle.loads(pickle.dumps((function, shared, number, task)))
        yield pickle.loads(pickle.dumps(call(*there)))
