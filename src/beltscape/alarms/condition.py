"""The condition of one alarm at one moment, from a value, its σ and a limit with hysteresis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from beltscape.core.live.alarms import Severity
from beltscape.core.live.findings import Finding

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
