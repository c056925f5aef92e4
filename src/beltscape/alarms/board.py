"""The board of all alarms: readings in, alarms and their changes out."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from threading import Lock

from beltscape.alarms.condition import AlarmCondition
from beltscape.alarms.readings import Readings
from beltscape.alarms.rules import RULES, Conditions
from beltscape.alarms.settings import AlarmSettings, CommonSettings, LoadSettings, NoMeasurement
from beltscape.alarms.state_machine import AlarmStateMachine, Delay, Elapsed
from beltscape.alarms.texts import format_detail
from beltscape.core.live import Alarm

_NAN = float("nan")


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
    """The text from when it was last past the limit."""

    @property
    def name(self) -> str:
        return f"{self.kind}:{self.subject}" if self.subject else self.kind

    def update(self, condition: AlarmCondition, elapsed: Elapsed, wall_ns: int) -> bool:
        """Add a condition; return whether the alarm's state changed."""
        if condition.state != "unknown" or self.machine.state == "clear":
            self.condition = condition  # an active alarm keeps showing its last known value
        self.was_off = self.was_off or condition.state == "off"
        if condition.state == "on":
            text = format_detail(self.kind, self.subject, condition.value, condition.limit, condition.unit)
            self.detail = condition.text or text
        return self.machine.update(
            condition.state, elapsed, self._delays(condition), wall_ns, latched=self.settings.latched
        )

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
            severity=self.settings.severity,
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
                conditions: Conditions = rule(readings, self._settings) if settings.enabled else {}
                for subject, condition in conditions.items():
                    entry = self._entry(kind, subject, settings)
                    updated.add(entry.name)
                    if entry.update(_without_unmeasured(entry, condition), elapsed, wall_ns):
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

    def _entry(self, kind: str, subject: str, settings: CommonSettings) -> _Entry:
        entry = _Entry(kind, subject, settings)
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
        entries = sorted(self._entries.values(), key=lambda entry: order[entry.kind])
        self._alarms = {entry.name: entry.to_alarm() for entry in entries}


def _without_unmeasured(entry: _Entry, condition: AlarmCondition) -> AlarmCondition:
    """Return the condition; unknown for a quantity, other than the load, that has never been measured."""
    if not isinstance(entry.settings, NoMeasurement) or entry.was_off or condition.state == "off":
        return condition
    if entry.subject == "load":
        return replace(condition, after_s=entry.settings.start_after_s)
    return AlarmCondition("unknown")


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)
