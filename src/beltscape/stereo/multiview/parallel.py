"""Independent jobs in threads, such as parts of an image's pixels; array operations release the interpreter lock."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from beltscape.core.system_calls import count_usable_cores
from beltscape.kernels.planes import FoundPixels, find_pixel_kernels

Result = TypeVar("Result")
Other = TypeVar("Other")
Pixels = tuple[NDArray[np.int_], ...]
"""Rows and columns of some pixels."""


def run_parallel(jobs: Sequence[Callable[[], Result]], threads: int) -> list[Result]:
    """Return the jobs' results in order; the jobs are independent, so the number of threads changes nothing."""
    threads = min(threads or count_usable_cores(), len(jobs))

    def call(job: Callable[[], Result]) -> Result:
        return job()

    if threads < 2:
        return [job() for job in jobs]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(call, jobs))


def find_pixels(mask: NDArray[np.bool_]) -> FoundPixels | NDArray[np.bool_]:
    """Return the pixels of a mask (H, W) on a GPU, whose number the processor need not know yet; else the mask."""
    kernels = find_pixel_kernels(mask)
    return kernels.find_pixels(mask) if kernels else mask


def split_pixels(found: FoundPixels | NDArray[np.bool_], most: int) -> list[Pixels]:
    """Return the pixels of `find_pixels` row by row, in parts of at most ``most``."""
    rows: Any
    columns: Any
    if isinstance(found, FoundPixels):
        rows, columns = found.cut()
    else:
        rows, columns = np.unravel_index(np.flatnonzero(found), found.shape)
    parts = (slice(first, first + most) for first in range(0, len(rows), most))
    return [(rows[part], columns[part]) for part in parts]


def collect_parallel(
    parts: Sequence[Callable[[], Iterable[tuple[str, Result]]]], threads: int
) -> dict[str, Result]:
    """Return what all parts yield by name; the parts are independent jobs."""

    def collect(part: Callable[[], Iterable[tuple[str, Result]]]) -> dict[str, Result]:
        return dict(part())

    collected = run_parallel([partial(collect, part) for part in parts], threads)
    return {name: value for values in collected for name, value in values.items()}


def run_pair(first: Callable[[], Result], second: Callable[[], Other], threads: int) -> tuple[Result, Other]:
    """Return the results of two independent jobs of different types; each may use all threads itself."""
    if (threads or count_usable_cores()) < 2:
        return first(), second()
    with ThreadPoolExecutor(1) as pool:
        pending = pool.submit(second)
        return first(), pending.result()
