"""Measurement of wall time, processor time and memory of a function."""

from __future__ import annotations

import multiprocessing
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import ParamSpec, TypeVar

import cv2
from threadpoolctl import threadpool_limits

P = ParamSpec("P")
R = TypeVar("R")

THREADS = (2, 1)
"""Numbers of threads; memory and processor time are measured with the first."""
_ENOUGH_S = 1.0
_CLEAR = Path("/proc/self/clear_refs")


def measure_seconds(work: Callable[[], object], runs: int = 5, enough_s: float = 0.6) -> float:
    """Return the median wall time after a warm-up, of ``runs`` runs or as many as fill ``enough_s``."""
    work()
    times: list[float] = []
    while not times or (len(times) < runs and sum(times) < enough_s):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


@dataclass(frozen=True)
class Cost:
    """Cost of one frame; wall time by number of threads."""

    wall_s: dict[int, float]
    cpu_s: float
    """Sum over all threads, for the first of `THREADS`."""
    peak_mb: float
    """Growth of the process while the matcher was prepared and used."""


def measure_cost(make: Callable[[int], Callable[[], R]]) -> tuple[R, Cost]:
    """Return the result of ``make(threads)()`` and its cost, the best of two or three runs.

    ``make`` is preparation that many frames share; it counts for memory, not for time.
    """
    _CLEAR.write_text("5")  # resets the peak
    base = memory_mb("VmRSS")
    wall: dict[int, float] = {}
    results: list[R] = []
    cpu = peak = None
    for threads in THREADS:
        cv2.setNumThreads(threads)
        with threadpool_limits(threads):
            work = make(threads)
            runs = []
            for _ in range(3):
                start = time.perf_counter(), time.process_time()
                results[:] = [work()]
                runs.append((time.perf_counter() - start[0], time.process_time() - start[1]))
                if sum(run[0] for run in runs) > _ENOUGH_S and (wall or len(runs) > 1):
                    break
            best = min(runs)
        wall[threads] = best[0]
        cpu = best[1] if cpu is None else cpu
        peak = memory_mb("VmHWM") - base if peak is None else peak
    if cpu is None or peak is None:
        raise ValueError("cost needs a number of threads")
    return results[0], Cost(wall, cpu, peak)


def run_in_fresh_process(work: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
    """Return the result of a call in a new process."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(work, *args, **kwargs).result()


def memory_mb(entry: str, process: int | str = "self") -> float:
    """Return a process's present (VmRSS) or peak (VmHWM) memory, MB; 0 after its end."""
    status = Path(f"/proc/{process}/status").read_text()
    line = next((line for line in status.splitlines() if line.startswith(entry)), None)
    return int(line.split()[1]) / 1000 if line else 0.0
