"""The condition of one alarm at one moment, and its state machine: raised after a delay, acknowledged, cleared.

A condition follows from a value, its σ and a limit with hysteresis. The machine's states are those of the diagram in
ANSI/ISA-18.2-2016 and IEC 62682: clear is normal (A), raised is unacknowledged (B), acknowledged is C, gone is
returned to normal unacknowledged (D) or, where the alarm must be reset, latched unacknowledged (E), latched is
latched acknowledged (F). G, H and I are suppressions: see `entry`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from beltscape.core.alarms import AlarmState, Severity
from beltscape.core.findings import Finding

ConditionState = Literal["on", "off", "between", "unknown"]
"""past the limit; back beyond the clear limit; between the two; not known"""

_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class AlarmCondition:
    """One alarm's condition at one moment, with the value and the limit that it follows from."""

    state: ConditionState
    value: float = _NAN
    """In ``unit``; NaN where the condition has no number."""
    limit: float = _NAN
    unit: str = ""
    text: str = ""
    """Description by the component that reports the condition, in one line; it replaces the alarm's own text."""
    after_s: float | None = None
    """Delay until the alarm is raised; it replaces the setting's."""
    clear_after_s: float | None = None
    """Delay until the alarm clears; it replaces the setting's."""
    severity: Severity | None = None
    """Replaces the setting's unless the project sets one; None: the setting's."""

    @property
    def excess(self) -> float:
        """Distance of the value's size from the limit's; NaN without a value."""
        return abs(abs(self.value) - self.limit)


def compare_upper(
    value: float, sigma: float, limit: float, hysteresis: float, sigmas: float = 0.0
) -> ConditionState:
    """Return how a value compares with an upper limit.

    On where value - sigmas·σ > limit: an uncertain value must exceed the limit by its uncertainty. Off where the
    value itself is at most limit·(1 - hysteresis). Between these nothing changes; the band grows with σ. An unknown σ
    counts as 0; a value that is not finite is unknown.
    """
    return _compare(value, sigma, limit, limit * (1 - hysteresis), sigmas)


def compare_lower(
    value: float, sigma: float, limit: float, hysteresis: float, sigmas: float = 0.0
) -> ConditionState:
    """Return how a value compares with a lower limit: on below it by sigmas·σ, off from limit·(1 + hysteresis)."""
    return _compare(-value, sigma, -limit, -limit * (1 + hysteresis), sigmas)


def condition_from_text(trouble: str | None) -> AlarmCondition:
    """Return the condition of a fault that is described by text: on with a text, off if empty, unknown for None."""
    if trouble is None:
        return AlarmCondition("unknown")
    return AlarmCondition("on", text=trouble) if trouble else AlarmCondition("off")


def condition_from_finding(finding: Finding) -> AlarmCondition:
    """Return the condition of a check's finding: on with a fault, off without, unknown where it was not made."""
    if finding.is_fault:
        return AlarmCondition(
            "on",
            finding.value,
            finding.limit,
            finding.unit,
            finding.text,
            severity="critical" if finding.effect == "missing" else "warning",
        )
    state: ConditionState = "off" if math.isfinite(finding.value) else "unknown"
    return AlarmCondition(state, finding.value, finding.limit, finding.unit)


def select_worst(conditions: Sequence[AlarmCondition]) -> AlarmCondition:
    """Combine several limits of one alarm: on if any is, off only if all are; return the first that decides."""
    if not conditions:
        return AlarmCondition("unknown")
    order: tuple[ConditionState, ...] = ("on", "unknown", "between", "off")
    return min(conditions, key=lambda condition: order.index(condition.state))


def _compare(value: float, sigma: float, limit: float, clear: float, sigmas: float) -> ConditionState:
    if not math.isfinite(value):
        return "unknown"
    spread = sigmas * sigma if sigmas > 0 and not math.isnan(sigma) else 0.0
    if value - spread > limit:
        return "on"
    return "off" if value <= clear else "between"


@dataclass(frozen=True, slots=True)
class AlarmDelay:
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

    @property
    def lasted_ns(self) -> int:
        """Return for how long the condition has been present; 0 where it is not."""
        return self._time_ns if self._is_present else 0

    def update(self, state: ConditionState, elapsed: Elapsed, delay: AlarmDelay) -> bool:
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
    """clear → raised → acknowledged → clear; raised → gone → clear once acknowledged, gone → raised again.

    An alarm that must be reset goes to latched instead of clear, and from there to clear by a reset.
    """

    state: AlarmState = "clear"
    since_ns: int | None = None
    """System clock when it was raised last; None while clear."""
    by: str = ""
    acknowledged_ns: int | None = None
    """System clock when it was acknowledged; None: not yet."""
    _needs_reset: bool = False
    _on: _Persistence = field(default_factory=lambda: _Persistence("on"))
    _off: _Persistence = field(default_factory=lambda: _Persistence("off"))

    def update(
        self,
        state: ConditionState,
        elapsed: Elapsed,
        delays: tuple[AlarmDelay, AlarmDelay],
        wall_ns: int,
        *,
        latched: bool,
        needs_reset: bool = False,
    ) -> bool:
        """Add one update, with the delays to raise and to clear; return whether the alarm's state changed.

        ``latched``: the alarm stays until it is acknowledged. ``needs_reset``: until it is acknowledged and reset.
        """
        self._needs_reset = needs_reset
        on = self._on.update(state, elapsed, delays[0])
        off = self._off.update(state, elapsed, delays[1])
        if on and self.state in ("clear", "gone", "latched"):
            self.state, self.since_ns = "raised", wall_ns
            self.by, self.acknowledged_ns = "", None
        elif off and self.state == "raised" and (latched or needs_reset):
            self.state = "gone"
        elif off and self.state in ("raised", "acknowledged"):
            self._end()
        else:
            return False
        return True

    @property
    def is_on(self) -> bool:
        """Return whether the alarm's condition holds, by its delays."""
        return self.state in ("raised", "acknowledged")

    @property
    def on_for_ns(self) -> int:
        """Return the time for which the condition has been on; 0 where it is not."""
        return self._on.lasted_ns

    def acknowledge(self, by: str, wall_ns: int = 0) -> bool:
        """Acknowledge the alarm at this system clock; return whether there was anything to acknowledge."""
        if self.state not in ("raised", "gone"):
            return False
        is_over = self.state == "gone"
        self.state, self.by, self.acknowledged_ns = "acknowledged", by, wall_ns
        if is_over:
            self._end()
        return True

    def restore(
        self, state: AlarmState, since_ns: int, by: str, acknowledged_ns: int | None, *, needs_reset: bool
    ) -> None:
        """Continue in a state of a run before; its delays begin anew."""
        self.state, self.since_ns, self._needs_reset = state, since_ns, needs_reset
        self.by, self.acknowledged_ns = by, acknowledged_ns

    def reset(self) -> bool:
        """Clear an alarm that has latched and is acknowledged; return whether it was one."""
        if self.state != "latched":
            return False
        self.clear()
        return True

    def annunciate_again(self) -> None:
        """Ask for a new acknowledgement while the condition holds; otherwise clear."""
        if self.is_on:
            self.state, self.by, self.acknowledged_ns = "raised", "", None
        else:
            self.clear()

    def restart(self) -> None:
        """Clear, and demand that a condition lasts anew for its delay."""
        self.clear()
        self._on, self._off = _Persistence("on"), _Persistence("off")

    def clear(self) -> None:
        """Return to the state without an alarm."""
        self.state, self.since_ns = "clear", None
        self.by, self.acknowledged_ns = "", None

    def _end(self) -> None:
        """Clear, or latch an alarm that must be reset; it keeps who acknowledged it."""
        if self._needs_reset:
            self.state = "latched"
        else:
            self.clear()
