"""Independent jobs in threads; array operations release the interpreter lock while they run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from beltscape.core.runtime.system_calls import count_usable_cores

Result = TypeVar("Result")
Other = TypeVar("Other")


def run_parallel(jobs: Sequence[Callable[[], Result]], threads: int) -> list[Result]:
    """Return the jobs' results in order; the jobs are independent, so the number of threads changes nothing."""
    threads = min(threads or count_usable_cores(), len(jobs))

    def call(job: Callable[[], Result]) -> Result:
        return job()

    if threads < 2:
        return [job() for job in jobs]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(call, jobs))


def run_pair(first: Callable[[], Result], second: Callable[[], Other], threads: int) -> tuple[Result, Other]:
    """Return the results of two independent jobs of different types; each may use all threads itself."""
    if (threads or count_usable_cores()) < 2:
        return first(), second()
    with ThreadPoolExecutor(1) as pool:
        pending = pool.submit(second)
        return first(), pending.result()
