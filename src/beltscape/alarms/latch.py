"""One alarm's memory: its delays, and who has seen it."""

from __future__ import annotations

from dataclasses import dataclass, field

from beltscape.alarms.finding import Condition
from beltscape.core.live import AlarmState


@dataclass(frozen=True, slots=True)
class Delay:
    """Both must have passed while a condition lasted."""

    time_ns: int
    belt_mm: float = 0.0


@dataclass(frozen=True, slots=True)
class Step:
    """What passed since the look before."""

    time_ns: int = 0
    belt_mm: float = 0.0


@dataclass(slots=True)
class _Hold:
    """How long a condition has lasted.

    Between two looks that say the same it was so, also where nobody knew in between: some values are measured now
    and then. A look that does not know says nothing by itself.
    """

    wanted: Condition
    _there: bool = False
    _time_ns: int = 0
    _belt_mm: float = 0.0

    def lasted(self, condition: Condition, step: Step, delay: Delay) -> bool:
        """Take in one look; whether the condition is known to be there and has lasted."""
        self._time_ns += step.time_ns
        self._belt_mm += step.belt_mm
        if condition == "unknown":
            return False
        if condition != self.wanted or not self._there:
            self._time_ns, self._belt_mm = 0, 0.0
        self._there = condition == self.wanted
        return self._there and self._time_ns >= delay.time_ns and self._belt_mm >= delay.belt_mm


@dataclass(slots=True)
class Latch:
    """clear → raised → acknowledged → clear; raised → gone → clear once acknowledged, gone → raised again."""

    state: AlarmState = "clear"
    since_ns: int | None = None
    """System clock when it was raised last; None while clear."""
    by: str = ""
    _on: _Hold = field(default_factory=lambda: _Hold("on"))
    _off: _Hold = field(default_factory=lambda: _Hold("off"))

    def look(
        self, condition: Condition, step: Step, delays: tuple[Delay, Delay], wall_ns: int, *, latched: bool
    ) -> bool:
        """Take in one look, with the delays until it is raised and until it is over; whether the state changed."""
        on = self._on.lasted(condition, step, delays[0])
        off = self._off.lasted(condition, step, delays[1])
        if on and self.state in ("clear", "gone"):
            self.state, self.since_ns, self.by = "raised", wall_ns, ""
        elif off and self.state == "raised" and latched:
            self.state = "gone"
        elif off and self.state in ("raised", "acknowledged"):
            self._clear()
        else:
            return False
        return True

    def acknowledge(self, by: str) -> bool:
        """Somebody has seen it; whether there was something to see."""
        if self.state == "raised":
            self.state, self.by = "acknowledged", by
            return True
        if self.state == "gone":
            self._clear()
            return True
        return False

    def _clear(self) -> None:
        self.state, self.since_ns, self.by = "clear", None, ""
