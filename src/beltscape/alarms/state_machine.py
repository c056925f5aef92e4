"""The state machine of one alarm: raised after a delay, acknowledged, cleared after a delay."""

from __future__ import annotations

from dataclasses import dataclass, field

from beltscape.alarms.condition import ConditionState
from beltscape.core.alarms import AlarmState


@dataclass(frozen=True, slots=True)
class Delay:
    """Time and belt travel for which a condition must last; both must have passed."""

    time_ns: int
    belt_mm: float = 0.0


@dataclass(frozen=True, slots=True)
class Elapsed:
    """Time and belt travel since the previous update."""

    time_ns: int = 0
    belt_mm: float = 0.0


@dataclass(slots=True)
class _Persistence:
    """The time and belt travel for which a condition has lasted.

    A condition is taken to last between two updates that report it, also across unknown ones between them: some
    values are measured only periodically. An unknown update alone decides nothing.
    """

    wanted: ConditionState
    _is_present: bool = False
    _time_ns: int = 0
    _belt_mm: float = 0.0

    def update(self, state: ConditionState, elapsed: Elapsed, delay: Delay) -> bool:
        """Add one update; return whether the condition is present and has lasted for ``delay``."""
        self._time_ns += elapsed.time_ns
        self._belt_mm += elapsed.belt_mm
        if state == "unknown":
            return False
        if state != self.wanted or not self._is_present:
            self._time_ns, self._belt_mm = 0, 0.0
        self._is_present = state == self.wanted
        return self._is_present and self._time_ns >= delay.time_ns and self._belt_mm >= delay.belt_mm


@dataclass(slots=True)
class AlarmStateMachine:
    """clear → raised → acknowledged → clear; raised → gone → clear once acknowledged, gone → raised again."""

    state: AlarmState = "clear"
    since_ns: int | None = None
    """System clock when it was raised last; None while clear."""
    by: str = ""
    _on: _Persistence = field(default_factory=lambda: _Persistence("on"))
    _off: _Persistence = field(default_factory=lambda: _Persistence("off"))

    def update(
        self,
        state: ConditionState,
        elapsed: Elapsed,
        delays: tuple[Delay, Delay],
        wall_ns: int,
        *,
        latched: bool,
    ) -> bool:
        """Add one update, with the delays to raise and to clear; return whether the alarm's state changed."""
        on = self._on.update(state, elapsed, delays[0])
        off = self._off.update(state, elapsed, delays[1])
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
        """Acknowledge the alarm; return whether there was anything to acknowledge."""
        if self.state == "raised":
            self.state, self.by = "acknowledged", by
            return True
        if self.state == "gone":
            self._clear()
            return True
        return False

    def _clear(self) -> None:
        self.state, self.since_ns, self.by = "clear", None, ""
