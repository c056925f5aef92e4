"""A histogram of the processing times of frame sets."""

from __future__ import annotations

from bisect import bisect_left
from itertools import accumulate
from math import isfinite

BOUNDS_S = (0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0)
"""Upper bounds of the bins, which contain the times of all presets and sizes; a last bin has no bound."""


class DurationHistogram:
    """Counts since the start. Written by one thread at a time."""

    def __init__(self) -> None:
        self._counts = [0] * (len(BOUNDS_S) + 1)
        self._sum_s = 0.0

    def add(self, seconds: float) -> None:
        """Count one time; NaN, infinite and negative times are ignored."""
        if isfinite(seconds) and seconds >= 0:
            self._counts[bisect_left(BOUNDS_S, seconds)] += 1
            self._sum_s += seconds

    def compute_cumulative(self) -> tuple[tuple[int, ...], float]:
        """Return the counts up to each bound and in total, and the sum in seconds."""
        return tuple(accumulate(self._counts)), self._sum_s
