"""Positions of the belt over time, interpolated between readings."""

from __future__ import annotations

from bisect import bisect_left
from threading import Condition
from time import monotonic_ns

_MOST = 20_000
"""Number of readings that are kept, which bounds the memory: 20 s at 1000 readings a second."""
_BEYOND = 2
"""A track is extrapolated at its last speed for this multiple of its last interval."""


class PositionTrack:
    """Positions at monotonic times; bounded in memory; usable from any thread."""

    def __init__(self, silent_ns: int) -> None:
        """``silent_ns``: gaps longer than this are not interpolated."""
        self._silent_ns = silent_ns
        self._times_ns: list[int] = []
        self._positions_mm: list[float] = []
        self._changed = Condition()
        self._closed = False

    def add(self, time_ns: int, position_mm: float) -> None:
        """Add a reading; one that is not later than the last replaces it."""
        with self._changed:
            if self._times_ns and time_ns <= self._times_ns[-1]:
                self._positions_mm[-1] = position_mm
            else:
                self._times_ns.append(time_ns)
                self._positions_mm.append(position_mm)
            if len(self._times_ns) > 2 * _MOST:
                del self._times_ns[:-_MOST], self._positions_mm[:-_MOST]
            self._changed.notify_all()

    def close(self) -> None:
        """End all waits; no more readings follow."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def position_at(self, time_ns: int, wait_ns: int = 0) -> float | None:
        """Return the position at a time, linear between readings; wait up to ``wait_ns`` for the reading after it.

        After the last reading the position is extrapolated at the last speed for twice the last interval, but not
        beyond ``silent_ns``. None before the first reading, within a gap, and beyond the extrapolation.
        """
        with self._changed:
            if self._expects_reading(wait_ns):
                self._changed.wait_for(
                    lambda: self._closed or (bool(self._times_ns) and self._times_ns[-1] >= time_ns),
                    wait_ns * 1e-9,
                )
            return self._interpolate(time_ns)

    def _expects_reading(self, wait_ns: int) -> bool:
        """Return whether a reading is due; waiting for a silent encoder would only delay frames."""
        if wait_ns <= 0 or not self._times_ns:
            return False
        return monotonic_ns() - self._times_ns[-1] < self._silent_ns

    def _interpolate(self, time_ns: int) -> float | None:
        times, positions = self._times_ns, self._positions_mm
        after = bisect_left(times, time_ns)
        if after < len(times) and times[after] == time_ns:
            return positions[after]
        if after == 0:
            return None
        if after == len(times):
            after -= 1
            if after == 0 or time_ns - times[after] > _BEYOND * (times[after] - times[after - 1]):
                return None
        first, second = times[after - 1], times[after]
        if second - first > self._silent_ns or time_ns - second > self._silent_ns:
            return None
        share = (time_ns - first) / (second - first)
        return positions[after - 1] + share * (positions[after] - positions[after - 1])
