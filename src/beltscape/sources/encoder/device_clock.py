"""Another machine's timestamps on this machine's steady clock."""

from __future__ import annotations

from dataclasses import dataclass

_WINDOW_NS = 10_000_000_000
_SET_BACK_NS = 1_000_000_000


@dataclass(slots=True)
class DeviceClock:
    """Least delay: of all messages of the last 10 to 20 s, the quickest tells how far the two clocks are apart.

    What is left is the quickest message's own delay, and the clocks' drift over that time (2 ms at 100 ppm). See
    Cristian 1989, 10.1007/BF01784024; one way only, so the least delay itself cannot be told from the offset.
    """

    _stamp_ns: int | None = None
    _since_ns: int = 0
    _least_ns: int | None = None
    _least_before_ns: int | None = None

    def steady_ns(self, stamp_ns: int, arrival_ns: int) -> int | None:
        """Steady time of a timestamp, never after its arrival; None for one that came out of order."""
        if self._stamp_ns is not None and stamp_ns < self._stamp_ns:
            if self._stamp_ns - stamp_ns < _SET_BACK_NS:
                return None
            self._least_ns = self._least_before_ns = None  # it was set back
        self._stamp_ns = stamp_ns
        if arrival_ns - self._since_ns > _WINDOW_NS:
            self._least_before_ns, self._least_ns, self._since_ns = self._least_ns, None, arrival_ns
        apart = arrival_ns - stamp_ns
        self._least_ns = apart if self._least_ns is None else min(apart, self._least_ns)
        known = [value for value in (self._least_ns, self._least_before_ns) if value is not None]
        return stamp_ns + min(known)
