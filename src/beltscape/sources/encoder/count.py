"""A device's count → millimetres of belt: wraps and resets undone."""

from __future__ import annotations

import math
from dataclasses import dataclass

from beltscape.sources.encoder.settings import EncoderSettings

_SLACK_MM = 100.0
"""A standing belt's count may be off by so much."""
_STEADY_NS = 0.3e9
"""The speed is a mean over so long: readings that were held up come all at once."""
_BACK_MM = 500.0
"""A loaded belt that stops may roll back; what runs back further is wired or set the wrong way round."""
_AHEAD_MM = 3000.0
"""By so much the ledger may be ahead of the belt: it counts what is in view upstream, and the belt rolls back."""


@dataclass(slots=True)
class Count:
    """Turns raw counts into one position over wraps, resets and restarts of the device; signed, as the belt moves.

    A counter of n bits wraps: of all steps that fit, that nearest to the mean speed's is taken. A step longer than
    the fastest belt's is no travel: the device was reset (then what it counted since from 0 is travel) or told
    nonsense (then nothing is). What such jumps took away stays in ``offset_mm``, to be kept over restarts.
    """

    settings: EncoderSettings
    offset_mm: float = 0.0
    """Position = counted mm + offset, of a counter that wraps up to whole wraps."""
    resume_mm: float | None = None
    """Where the ledger of the belt ended: the first position is not much before it."""
    jumps: int = 0
    """How often the count jumped."""
    jump_mm: float = 0.0
    """How far it jumped last."""
    _raw_mm: float | None = None
    _time_ns: int = 0
    _speed_mm_ns: float = 0.0
    _position_mm: float = 0.0
    _farthest_mm: float = 0.0

    def position_mm(self, raw: float, time_ns: int) -> float:
        """Position of a further reading, in order of time."""
        raw_mm = (-raw if self.settings.reverse else raw) * self.settings.mm_per_count
        if self._raw_mm is None:
            self._position_mm = self._farthest_mm = self._first(raw_mm)
        else:
            self._position_mm += self._travel(raw_mm, self._raw_mm, time_ns)
        self._raw_mm, self._time_ns = raw_mm, time_ns
        self._farthest_mm = max(self._farthest_mm, self._position_mm)
        return self._position_mm

    @property
    def back_mm(self) -> float:
        """How far the belt is behind where it was already, where that is more than rolling back; else 0."""
        back = self._farthest_mm - self._position_mm
        return back if back > _BACK_MM else 0.0

    @property
    def _span_mm(self) -> float | None:
        bits = self.settings.counter_bits
        return None if bits is None else 2.0**bits * self.settings.mm_per_count

    def _first(self, raw_mm: float) -> float:
        position = raw_mm + self.offset_mm
        span, end = self._span_mm, self.resume_mm
        if span is not None:
            least = 0.0 if end is None else end - _AHEAD_MM
            position += span * -((position - least) // span)
        elif end is not None and position < end - _AHEAD_MM:  # reset while nobody listened
            self._jumped(position - end)
            position = end
        return position

    def _travel(self, raw_mm: float, before_mm: float, time_ns: int) -> float:
        passed_ns = max(0, time_ns - self._time_ns)
        travel = self._nearest(raw_mm - before_mm, self._speed_mm_ns * passed_ns)
        # held up and come all at once, or out of order: a step that is allowed may take no time at all
        allowed_s = max(1e-9 * passed_ns, self.settings.silent_s)
        most = self.settings.fastest_mm_s * allowed_s + _SLACK_MM
        if abs(travel) <= most:
            self._follow(travel, passed_ns)
            return travel
        since = self._nearest(raw_mm, 0.0)
        kept = since if 0 <= since <= most else 0.0
        self._jumped(travel - kept)
        return kept

    def _follow(self, travel_mm: float, passed_ns: int) -> None:
        """Bring the mean speed up to date."""
        share = passed_ns / _STEADY_NS
        gain = 1 / _STEADY_NS if share < 1e-6 else -math.expm1(-share) / passed_ns
        speed = self._speed_mm_ns + gain * (travel_mm - self._speed_mm_ns * passed_ns)
        fastest = 1e-9 * self.settings.fastest_mm_s
        self._speed_mm_ns = min(max(speed, -fastest), fastest)

    def _nearest(self, step_mm: float, expected_mm: float) -> float:
        """The step itself, or of a counter that wraps the nearest to what is expected."""
        span = self._span_mm
        return step_mm if span is None else step_mm - span * round((step_mm - expected_mm) / span)

    def _jumped(self, by_mm: float) -> None:
        self.jumps += 1
        self.jump_mm = by_mm
        self.offset_mm -= by_mm
