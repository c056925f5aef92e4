"""Conversion of another machine's timestamps to this machine's monotonic clock."""

from __future__ import annotations

from dataclasses import dataclass

_WINDOW_NS = 10_000_000_000
"""Half of the time in which the fastest message counts; at 100 ppm the clocks drift by 2 ms in 20 s."""
_STEP_NS = 1_000_000_000
"""Time over which the timestamps' speed is measured."""
_SET_BACK_NS = 1_000_000_000
"""Timestamps that go back by less belong to messages out of order; clocks are set back by more."""


@dataclass(slots=True)
class DeviceClock:
    """Clock offset by the least delay: the fastest message of the last 10 to 20 s determines it.

    The remaining error is that message's own delay and the clocks' drift over that time (2 ms at 100 ppm). See
    Cristian 1989, 10.1007/BF01784024; messages go one way only, so delay and offset cannot be separated.
    """

    _stamp_ns: int | None = None
    _since_ns: int = 0
    _least_ns: int | None = None
    _least_before_ns: int | None = None
    _step: tuple[int, int] | None = None
    """Timestamp and arrival at the beginning of the present step."""

    def find_speed(self, stamp_ns: int, arrival_ns: int) -> float:
        """Return the speed of the timestamps over that of this machine's clock, in seconds' steps; 0 between them."""
        if self._step is None:
            self._step = (stamp_ns, arrival_ns)
        stamp, arrival = self._step
        if arrival_ns - arrival < _STEP_NS:
            return 0.0
        self._step = (stamp_ns, arrival_ns)
        return (stamp_ns - stamp) / (arrival_ns - arrival)

    def steady_ns(self, stamp_ns: int, arrival_ns: int) -> int | None:
        """Return the monotonic time of a timestamp, never after its arrival; None for one out of order."""
        if self._stamp_ns is not None and stamp_ns < self._stamp_ns:
            if self._stamp_ns - stamp_ns < _SET_BACK_NS:
                return None
            self._least_ns = self._least_before_ns = None  # the device's clock was set back
        self._stamp_ns = stamp_ns
        if arrival_ns - self._since_ns > _WINDOW_NS:
            self._least_before_ns, self._least_ns, self._since_ns = self._least_ns, None, arrival_ns
        delay_ns = arrival_ns - stamp_ns
        self._least_ns = delay_ns if self._least_ns is None else min(delay_ns, self._least_ns)
        delays_ns = [value for value in (self._least_ns, self._least_before_ns) if value is not None]
        return stamp_ns + min(delays_ns)
