"""One alarm of the board: its state machine, its last condition, its text and its suppression."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from beltscape.alarms.settings import CommonSettings, FaultAlarm, LoadSettings
from beltscape.alarms.snapshot import SavedAlarm, SavedText
from beltscape.alarms.state_machine import AlarmCondition, AlarmDelay, AlarmStateMachine, Elapsed
from beltscape.alarms.texts import CustomTexts, format_amount, format_detail, format_over, format_unknown
from beltscape.core.alarm_catalogue import MISALIGNED_BELT, OVERSIZE_LUMP
from beltscape.core.alarms import Alarm, AlarmState, Priority, Severity, Suppression

_PERIODIC = (OVERSIZE_LUMP, MISALIGNED_BELT)
"""Kinds whose values are measured periodically."""
_FORGOTTEN_NS, _FORGOTTEN_PERIODIC_NS = 2_000_000_000, 120_000_000_000
"""Time after which a value that is no longer measured says nothing about now: four evaluations of the alarms, and
`NoMeasurement.seldom_after_s`."""


@dataclass(slots=True)
class AlarmEntry:
    """One alarm: its state machine and its last known condition."""

    kind: str
    subject: str
    settings: CommonSettings
    priority: Priority
    group: str
    """Name of its group for first-out; empty: none."""
    place: int
    """Its place in the group's list."""
    texts: CustomTexts
    machine: AlarmStateMachine = field(default_factory=AlarmStateMachine)
    was_off: bool = False
    """Whether its condition has ever been off."""
    condition: AlarmCondition = field(default_factory=lambda: AlarmCondition("unknown"))
    detail: str = ""
    """The text of ``condition``."""
    severity: Severity = "warning"
    suppression: Suppression | None = None
    present: AlarmCondition = field(default_factory=lambda: AlarmCondition("unknown"))
    """The newest condition that was known."""
    unknown_ns: int = 0
    """Time since it was."""
    onset_ns: int = 0
    """Steady clock when the condition that raised it began."""
    _state_before: AlarmState = "clear"
    """Its machine's state before the last update."""
    _was_clear: bool = False
    """Whether it was clear before the present suppression began."""

    @property
    def name(self) -> str:
        """Return the alarm's name."""
        return make_name(self.kind, self.subject)

    @property
    def state(self) -> AlarmState:
        """Return the state that is shown: "clear" while suppressed."""
        return self.machine.state if self.suppression is None else "clear"

    def take_over(self, other: AlarmEntry) -> None:
        """Continue the state of another entry of the same alarm, by own settings."""
        self.machine, self.was_off, self.condition = other.machine, other.was_off, other.condition
        self.detail, self.severity, self.onset_ns = other.detail, other.severity, other.onset_ns
        self.suppression, self._was_clear = other.suppression, other._was_clear
        self._state_before = other._state_before
        self.present, self.unknown_ns = other.present, other.unknown_ns

    def update(self, condition: AlarmCondition, elapsed: Elapsed, wall_ns: int, steady_ns: int) -> None:
        """Add a condition."""
        self._state_before = self.machine.state
        self.unknown_ns += elapsed.time_ns
        if condition.state != "unknown":
            self.present, self.unknown_ns = condition, 0
        if self.machine.state == "clear" or self._is_worse(condition):
            self._show(condition)
        self.was_off = self.was_off or condition.state == "off"
        changed = self.machine.update(
            condition.state,
            elapsed,
            self._delays(condition),
            wall_ns,
            latched=self.settings.latched,
            needs_reset=self.settings.needs_reset,
        )
        if changed and self.machine.state == "raised":
            self.onset_ns = steady_ns - self.machine.on_for_ns

    def suppress(self, suppression: Suppression | None) -> None:
        """Begin, change or end the suppression.

        After a suppression by a state of the plant, an alarm from before goes on, and one that came meanwhile must
        prove itself anew: its values may still be those of that state. After a suppression by a person an alarm whose
        condition holds is unacknowledged, and one that is over is clear, as in the diagram of ANSI/ISA-18.2.
        """
        before, self.suppression = self.suppression, suppression
        if before is None:
            self._was_clear = self._state_before == "clear"
        elif suppression is None and before.kind != "by_state":
            self.machine.annunciate_again()
        elif suppression is None and self._was_clear and self.machine.state != "clear":
            self.machine.restart()

    def to_saved(self) -> SavedAlarm | None:
        """Return what outlives a restart; None where it is clear, or must prove itself anew after a suppression."""
        machine, hidden = self.machine, self.suppression
        is_by_state = hidden is not None and hidden.kind == "by_state"
        if machine.state == "clear" or machine.since_ns is None or (is_by_state and self._was_clear):
            return None
        value, limit = self.condition.value, self.condition.limit
        return SavedAlarm(
            name=self.name,
            state=machine.state,
            severity=self.severity,
            since_ns=machine.since_ns,
            by=machine.by,
            acknowledged_ns=machine.acknowledged_ns,
            value=value if math.isfinite(value) else None,
            limit=limit if math.isfinite(limit) else None,
            unit=self.condition.unit,
            detail=SavedText.from_text(self.detail),
            state_of_plant=hidden.reason if hidden is not None and is_by_state else "",
        )

    def restore(self, saved: SavedAlarm, onset_ns: int) -> None:
        """Continue in the state of a run before; ``onset_ns`` says when its condition began, before all new ones."""
        value = math.nan if saved.value is None else saved.value
        limit = math.nan if saved.limit is None else saved.limit
        self.machine.restore(
            saved.state,
            saved.since_ns,
            saved.by,
            saved.acknowledged_ns,
            needs_reset=self.settings.needs_reset,
        )
        self.condition = AlarmCondition("on", value, limit, saved.unit)
        self.detail, self.severity, self.onset_ns = saved.detail.to_text(), saved.severity, onset_ns
        self._state_before, self._was_clear = saved.state, False

    def _is_worse(self, condition: AlarmCondition) -> bool:
        """Return whether an active alarm shows a condition: not the present value, but the worst past the limit."""
        if condition.state != "on":
            return False
        is_new = self.machine.state in ("gone", "latched") or self.condition.state != "on"
        has_changed = (condition.limit, condition.unit) != (self.condition.limit, self.condition.unit)
        return is_new or has_changed or not condition.excess < self.condition.excess

    def _show(self, condition: AlarmCondition) -> None:
        self.condition = condition
        if condition.state != "on":
            return
        value, limit, unit = condition.value, condition.limit, condition.unit
        own = condition.text or format_detail(self.kind, self.subject, value, limit, unit)
        amounts = format_amount(value, unit), format_amount(limit, unit)
        self.detail = self.texts.compose_detail(self.name, self.subject, *amounts, own)
        is_set = condition.severity is None or "severity" in self.settings.model_fields_set
        self.severity = self.settings.severity if is_set else condition.severity or "warning"

    def _delays(self, condition: AlarmCondition) -> tuple[AlarmDelay, AlarmDelay]:
        settings = self.settings
        after_s = settings.after_s if condition.after_s is None else condition.after_s
        clear_after_s = settings.clear_after_s if condition.clear_after_s is None else condition.clear_after_s
        travel = (
            (settings.after_mm, settings.clear_after_mm) if isinstance(settings, LoadSettings) else (0.0, 0.0)
        )
        return AlarmDelay(_ns(after_s), travel[0]), AlarmDelay(_ns(clear_after_s), travel[1])

    @property
    def is_known(self) -> bool:
        """Return whether what the alarm rests on is measured now."""
        periodic = self.kind in _PERIODIC or isinstance(self.settings, FaultAlarm)
        return self.unknown_ns <= (_FORGOTTEN_PERIODIC_NS if periodic else _FORGOTTEN_NS)

    def _describe_now(self) -> tuple[AlarmCondition, str]:
        """Return condition and text as they are now: an alarm that is over keeps neither value nor advice."""
        state, present, worst = self.machine.state, self.present, self.condition
        if state in ("gone", "latched"):
            limit = worst.limit if math.isnan(present.limit) else present.limit
            now = AlarmCondition("off", present.value if self.is_known else math.nan, limit, worst.unit)
            return now, format_over(state, now.value, limit, worst.unit)
        has_number = math.isfinite(worst.value) and not isinstance(self.settings, FaultAlarm)
        if state != "clear" and has_number and not self.is_known:
            return worst, format_unknown(worst.value, worst.limit, worst.unit)
        return worst, "" if state == "clear" else self.detail

    def to_alarm(self, *, is_first: bool, consequences: tuple[str, ...] = ()) -> Alarm:
        """Return the alarm in its present state.

        ``is_first``: it came first in its group; ``consequences``: the alarms that it explains and hides.
        """
        machine, state = self.machine, self.state
        condition, detail = self._describe_now()
        return Alarm(
            name=self.name,
            severity=self.severity,
            state=state,
            value=condition.value,
            limit=condition.limit,
            unit=condition.unit,
            since_ns=None if state == "clear" else machine.since_ns,
            detail=detail,
            by="" if state == "clear" else machine.by,
            acknowledged_ns=None if state == "clear" else machine.acknowledged_ns,
            priority=self.priority,
            group=self.group,
            is_first=is_first and state != "clear",
            needs_reset=self.settings.needs_reset,
            suppression=self.suppression,
            hidden_state="clear" if self.suppression is None else machine.state,
            is_known=machine.state == "clear" or self.is_known,
            consequences=consequences,
        )


def make_name(kind: str, subject: str) -> str:
    """Return the name of an alarm."""
    return f"{kind}:{subject}" if subject else kind


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)
