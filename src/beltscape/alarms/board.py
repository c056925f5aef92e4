"""The board of all alarms: readings in, alarms and their changes out."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from threading import Lock

from beltscape.alarms.condition import AlarmCondition, condition_from_finding
from beltscape.alarms.readings import Readings
from beltscape.alarms.rules import RULES, Conditions
from beltscape.alarms.settings import AlarmSettings, CommonSettings, LoadSettings, NoMeasurement
from beltscape.alarms.state_machine import AlarmStateMachine, Delay, Elapsed
from beltscape.alarms.texts import format_detail
from beltscape.core.alarms import Alarm, Severity

_NAN = float("nan")
_ALWAYS = ("disk_full", "recording_paused", "certificate_expiring")
"""Alarms that are evaluated during maintenance as well: they do not depend on what the cameras see."""


@dataclass(slots=True)
class _Entry:
    """One alarm: its state machine and its last known condition."""

    kind: str
    subject: str
    settings: CommonSettings
    machine: AlarmStateMachine = field(default_factory=AlarmStateMachine)
    was_off: bool = False
    """Whether its condition has ever been off."""
    condition: AlarmCondition = field(default_factory=lambda: AlarmCondition("unknown"))
    detail: str = ""
    """The text of ``condition``."""
    severity: Severity = "warning"

    @property
    def name(self) -> str:
        return _make_name(self.kind, self.subject)

    def update(self, condition: AlarmCondition, elapsed: Elapsed, wall_ns: int) -> bool:
        """Add a condition; return whether the alarm's state changed."""
        if self.machine.state == "clear" or self._is_worse(condition):
            self._show(condition)
        self.was_off = self.was_off or condition.state == "off"
        return self.machine.update(
            condition.state, elapsed, self._delays(condition), wall_ns, latched=self.settings.latched
        )

    def _is_worse(self, condition: AlarmCondition) -> bool:
        """Return whether an active alarm shows a condition: not the present value, but the worst past the limit."""
        if condition.state != "on":
            return False
        is_new = self.machine.state == "gone" or self.condition.state != "on"
        has_changed = (condition.limit, condition.unit) != (self.condition.limit, self.condition.unit)
        return is_new or has_changed or not condition.excess < self.condition.excess

    def _show(self, condition: AlarmCondition) -> None:
        self.condition = condition
        if condition.state != "on":
            return
        self.detail = condition.text or format_detail(
            self.kind, self.subject, condition.value, condition.limit, condition.unit
        )
        is_set = condition.severity is None or "severity" in self.settings.model_fields_set
        self.severity = self.settings.severity if is_set else condition.severity or "warning"

    def _delays(self, condition: AlarmCondition) -> tuple[Delay, Delay]:
        settings = self.settings
        after_s = settings.after_s if condition.after_s is None else condition.after_s
        clear_after_s = settings.clear_after_s if condition.clear_after_s is None else condition.clear_after_s
        travel = (
            (settings.after_mm, settings.clear_after_mm) if isinstance(settings, LoadSettings) else (0.0, 0.0)
        )
        return Delay(_ns(after_s), travel[0]), Delay(_ns(clear_after_s), travel[1])

    def to_alarm(self) -> Alarm:
        """Return the alarm in its present state."""
        clear = self.machine.state == "clear"
        return Alarm(
            name=self.name,
            severity=self.severity,
            state=self.machine.state,
            value=self.condition.value,
            limit=self.condition.limit,
            unit=self.condition.unit,
            since_ns=self.machine.since_ns,
            detail="" if clear else self.detail,
            by=self.machine.by,
        )


class AlarmBoard:
    """All alarms; updated with readings by one thread, read and acknowledged from any.

    Delays run by the monotonic clock and the belt's travel; the system clock is only recorded. Nothing is kept over
    a restart: alarms whose condition still holds are raised again.
    """

    def __init__(self, settings: AlarmSettings) -> None:
        self._settings = settings
        self._lock = Lock()
        self._entries: dict[str, _Entry] = {}
        self._alarms: dict[str, Alarm] = {}
        self._steady_ns: int | None = None
        self._belt_mm = _NAN

    def update(self, readings: Readings, wall_ns: int, steady_ns: int) -> tuple[Alarm, ...]:
        """Apply the readings of one moment; return the alarms whose state they changed."""
        with self._lock:
            elapsed = self._elapsed(readings, steady_ns)
            changed: list[Alarm] = []
            updated: set[str] = set()
            for kind, rule in RULES.items():
                settings: CommonSettings = getattr(self._settings, kind)
                is_evaluated = settings.enabled and (kind in _ALWAYS or not readings.is_maintained)
                conditions: Conditions = rule(readings, self._settings) if is_evaluated else {}
                for subject, condition in conditions.items():
                    entry = self._entry(kind, subject, settings)
                    updated.add(entry.name)
                    if entry.update(_without_unmeasured(entry, condition), elapsed, wall_ns):
                        changed.append(entry.to_alarm())
            for kind, subject, condition in self._list_faults(readings):
                entry = self._entry(kind, subject, self._settings.select_fault(kind))
                updated.add(entry.name)
                if entry.update(condition, elapsed, wall_ns):
                    changed.append(entry.to_alarm())
            for name, entry in self._entries.items():
                if name not in updated:  # a camera without health in these readings
                    entry.update(AlarmCondition("unknown"), elapsed, wall_ns)
            self._refresh_alarms()
            return tuple(changed)

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """All alarms, also the clear ones, in a fixed order; cameras in the order of their first readings."""
        with self._lock:
            return tuple(self._alarms.values())

    def acknowledge(self, name: str, by: str, wall_ns: int) -> bool:  # noqa: ARG002  (for the caller's log)
        """Acknowledge the alarm ``name``; return False if it is clear, acknowledged already, or unknown."""
        with self._lock:
            entry = self._entries.get(name)
            if entry is None or not entry.machine.acknowledge(by):
                return False
            self._refresh_alarms()
            return True

    def _list_faults(self, readings: Readings) -> list[tuple[str, str, AlarmCondition]]:
        """Return check, subject and condition of the findings that are, or were, faults."""
        if readings.is_maintained:
            return []
        return [
            (finding.check, finding.subject, condition_from_finding(finding))
            for finding in readings.findings
            if self._settings.select_fault(finding.check).enabled
            and (finding.is_fault or _make_name(finding.check, finding.subject) in self._entries)
        ]

    def _entry(self, kind: str, subject: str, settings: CommonSettings) -> _Entry:
        entry = _Entry(kind, subject, settings, severity=settings.severity)
        return self._entries.setdefault(entry.name, entry)

    def _elapsed(self, readings: Readings, steady_ns: int) -> Elapsed:
        """Return time and travel since the previous update; a belt at an unknown position has not moved."""
        time_ns = 0 if self._steady_ns is None else max(0, steady_ns - self._steady_ns)
        self._steady_ns = steady_ns if self._steady_ns is None else max(steady_ns, self._steady_ns)
        travel_mm = readings.belt_mm - self._belt_mm
        if math.isfinite(readings.belt_mm):
            self._belt_mm = readings.belt_mm
        return Elapsed(time_ns, max(0.0, travel_mm) if math.isfinite(travel_mm) else 0.0)

    def _refresh_alarms(self) -> None:
        order = {kind: index for index, kind in enumerate(RULES)}
        entries = sorted(self._entries.values(), key=lambda entry: order.get(entry.kind, len(order)))
        self._alarms = {entry.name: entry.to_alarm() for entry in entries}


def _without_unmeasured(entry: _Entry, condition: AlarmCondition) -> AlarmCondition:
    """Return the condition; unknown for a quantity, other than the load, that has never been measured."""
    if not isinstance(entry.settings, NoMeasurement) or entry.was_off or condition.state == "off":
        return condition
    if entry.subject == "load":
        return replace(condition, after_s=entry.settings.start_after_s)
    return AlarmCondition("unknown")


def _make_name(kind: str, subject: str) -> str:
    return f"{kind}:{subject}" if subject else kind


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)
