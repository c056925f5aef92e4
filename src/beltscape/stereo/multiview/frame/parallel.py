"""A few independent pieces of work at once: array operations let go of the interpreter while they work."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Result = TypeVar("Result")
Other = TypeVar("Other")


def run_parallel(jobs: Sequence[Callable[[], Result]], threads: int) -> list[Result]:
    """The jobs' results in their order; each job is on its own, so the number of threads changes nothing."""
    threads = min(threads or os.cpu_count() or 1, len(jobs))
    if threads < 2:
        return [job() for job in jobs]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(lambda job: job(), jobs))


def run_pair(one: Callable[[], Result], other: Callable[[], Other], threads: int) -> tuple[Result, Other]:
    """The results of two jobs of different kinds; each is on its own, and may use all threads itself."""
    if (threads or os.cpu_count() or 1) < 2:
        return one(), other()
    with ThreadPoolExecutor(1) as pool:
        found = pool.submit(other)
        return one(), found.result()
