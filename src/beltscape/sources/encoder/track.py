"""Readings over time, and the position between them."""

from __future__ import annotations

from bisect import bisect_left
from threading import Condition
from time import monotonic_ns

_MOST = 20_000
_BEYOND = 2
"""So many times its last interval a track goes on at its last speed."""


class Track:
    """Positions at steady times; bounded in memory; from any thread."""

    def __init__(self, silent_ns: int) -> None:
        """Over a gap longer than ``silent_ns`` nothing is told."""
        self._silent_ns = silent_ns
        self._times_ns: list[int] = []
        self._positions_mm: list[float] = []
        self._changed = Condition()
        self._closed = False

    def add(self, time_ns: int, position_mm: float) -> None:
        """A further reading; one that is no later than the last takes its place."""
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
        """Nothing more comes: nobody needs to wait."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def at(self, time_ns: int, wait_ns: int = 0) -> float | None:
        """Position at a time, linear between readings; waits so long for the reading after it.

        After the last reading it goes on at the last speed for twice the last interval, but not into silence. None
        before the first reading, within a gap, and beyond.
        """
        with self._changed:
            if self._speaking(wait_ns):
                self._changed.wait_for(
                    lambda: self._closed or (bool(self._times_ns) and self._times_ns[-1] >= time_ns),
                    wait_ns * 1e-9,
                )
            return self._at(time_ns)

    def _speaking(self, wait_ns: int) -> bool:
        """Whether a reading may be expected: waiting for one that is silent would only hold up frames."""
        if wait_ns <= 0 or not self._times_ns:
            return False
        return monotonic_ns() - self._times_ns[-1] < self._silent_ns

    def _at(self, time_ns: int) -> float | None:
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
