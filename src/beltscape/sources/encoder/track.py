"""Positions of the belt over time: counts as millimetres, wraps and resets removed, interpolated between readings."""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass
from threading import Condition
from time import monotonic_ns

from beltscape.sources.encoder.settings import EncoderSettings

_MOST_READINGS = 20_000
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
            if len(self._times_ns) > 2 * _MOST_READINGS:
                del self._times_ns[:-_MOST_READINGS], self._positions_mm[:-_MOST_READINGS]
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


_SLACK_MM = 100.0
"""Tolerated change of a stopped belt's count, for play and a creeping stop; chosen."""
_MEAN_NS = 0.3e9
"""Time constant of the mean speed: readings that were delayed arrive all at once, over tenths of a second."""
_ROLL_BACK_MM = 500.0
"""A loaded belt that stops may roll back this far; beyond it the encoder is wired or set in reverse. Chosen."""
_AHEAD_MM = 3000.0
"""The ledger may be ahead of the belt by this much: it counts belt in view upstream, and the belt rolls back."""


@dataclass(slots=True)
class CountUnwrapper:
    """Unwraps raw counts to one signed position across wraps, resets and restarts of the device.

    A counter of n bits wraps: of all possible steps, the one nearest to the mean speed's is taken. A step longer than
    the fastest belt's is no travel: either the device was reset (its count since 0 is travel) or the reading is
    wrong (nothing is). The sum of such jumps is in ``offset_mm``, which must be stored over restarts.
    """

    settings: EncoderSettings
    offset_mm: float = 0.0
    """Position = counted mm + offset, up to whole wraps of the counter."""
    resume_mm: float | None = None
    """End of the belt ledger: the first position is not much before it."""
    jumps: int = 0
    """Number of jumps of the count."""
    jump_mm: float = 0.0
    """Size of the last jump."""
    _raw_mm: float | None = None
    _time_ns: int = 0
    _speed_mm_ns: float = 0.0
    _position_mm: float = 0.0
    _farthest_mm: float = 0.0

    def position_mm(self, raw: float, time_ns: int) -> float:
        """Return the position of the next reading; readings come in order of time."""
        raw_mm = (-raw if self.settings.reverse else raw) * self.settings.mm_per_count
        if self._raw_mm is None:
            self._position_mm = self._farthest_mm = self._initial_position_mm(raw_mm)
        else:
            self._position_mm += self._travel_mm(raw_mm, self._raw_mm, time_ns)
        self._raw_mm, self._time_ns = raw_mm, time_ns
        self._farthest_mm = max(self._farthest_mm, self._position_mm)
        return self._position_mm

    @property
    def back_mm(self) -> float:
        """Distance of the belt behind its farthest position, if that exceeds rolling back; else 0."""
        back = self._farthest_mm - self._position_mm
        return back if back > _ROLL_BACK_MM else 0.0

    @property
    def _span_mm(self) -> float | None:
        bits = self.settings.counter_bits
        return None if bits is None else 2.0**bits * self.settings.mm_per_count

    def _initial_position_mm(self, raw_mm: float) -> float:
        position = raw_mm + self.offset_mm
        span, end = self._span_mm, self.resume_mm
        if span is not None:
            least = 0.0 if end is None else end - _AHEAD_MM
            position += span * -((position - least) // span)
        elif end is not None and position < end - _AHEAD_MM:  # reset while the program was not running
            self._record_jump(position - end)
            position = end
        return position

    def _travel_mm(self, raw_mm: float, before_mm: float, time_ns: int) -> float:
        passed_ns = max(0, time_ns - self._time_ns)
        travel = self._unwrap(raw_mm - before_mm, self._speed_mm_ns * passed_ns)
        # delayed readings arrive all at once or out of order, so an allowed step may take no time
        allowed_s = max(1e-9 * passed_ns, self.settings.silent_s)
        most = self.settings.fastest_mm_s * allowed_s + _SLACK_MM
        if abs(travel) <= most:
            self._update_speed(travel, passed_ns)
            return travel
        since = self._unwrap(raw_mm, 0.0)
        travel_since_reset = since if 0 <= since <= most else 0.0
        self._record_jump(travel - travel_since_reset)
        return travel_since_reset

    def _update_speed(self, travel_mm: float, passed_ns: int) -> None:
        """Update the mean speed."""
        share = passed_ns / _MEAN_NS
        gain = 1 / _MEAN_NS if share < 1e-6 else -math.expm1(-share) / passed_ns
        speed = self._speed_mm_ns + gain * (travel_mm - self._speed_mm_ns * passed_ns)
        fastest = 1e-9 * self.settings.fastest_mm_s
        self._speed_mm_ns = min(max(speed, -fastest), fastest)

    def _unwrap(self, step_mm: float, expected_mm: float) -> float:
        """Return the step; for a counter that wraps, the possible step nearest to the expected one."""
        span = self._span_mm
        return step_mm if span is None else step_mm - span * round((step_mm - expected_mm) / span)

    def _record_jump(self, by_mm: float) -> None:
        self.jumps += 1
        self.jump_mm = by_mm
        self.offset_mm -= by_mm
