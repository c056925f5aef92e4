"""A few independent pieces of work at once: array operations let go of the interpreter while they work."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Result = TypeVar("Result")


def side_by_side(jobs: Sequence[Callable[[], Result]], threads: int) -> list[Result]:
    """The jobs' results in their order; each job is on its own, so the number of threads changes nothing."""
    threads = min(threads or os.cpu_count() or 1, len(jobs))
    if threads < 2:
        return [job() for job in jobs]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(lambda job: job(), jobs))
