"""All alarms together."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from threading import Lock

from beltscape.alarms.finding import Finding
from beltscape.alarms.latch import Delay, Latch, Step
from beltscape.alarms.readings import Readings
from beltscape.alarms.rules import RULES
from beltscape.alarms.settings import AlarmSettings, NoMeasurement, Watch, WatchAlong
from beltscape.alarms.texts import detail
from beltscape.core.live import Alarm

_NAN = float("nan")


@dataclass(slots=True)
class _Entry:
    """One alarm: its memory and what was last found."""

    kind: str
    subject: str
    watch: Watch
    latch: Latch = field(default_factory=Latch)
    known: bool = False
    """Whether it has ever been known to be off."""
    finding: Finding = field(default_factory=lambda: Finding("unknown"))
    detail: str = ""
    """As it was when last past the limit."""

    @property
    def name(self) -> str:
        return f"{self.kind}:{self.subject}" if self.subject else self.kind

    def look(self, finding: Finding, step: Step, wall_ns: int) -> bool:
        """Take in a finding; whether the alarm's state changed."""
        if finding.condition != "unknown" or self.latch.state == "clear":
            self.finding = finding  # an alarm that stands shows what it was last judged by
        self.known = self.known or finding.condition == "off"
        if finding.condition == "on":
            said = detail(self.kind, self.subject, finding.value, finding.limit, finding.unit)
            self.detail = finding.said or said
        return self.latch.look(
            finding.condition, step, self._delays(finding), wall_ns, latched=self.watch.latched
        )

    def _delays(self, finding: Finding) -> tuple[Delay, Delay]:
        watch = self.watch
        after_s = watch.after_s if finding.after_s is None else finding.after_s
        clear_after_s = watch.clear_after_s if finding.clear_after_s is None else finding.clear_after_s
        along = (watch.after_mm, watch.clear_after_mm) if isinstance(watch, WatchAlong) else (0.0, 0.0)
        return Delay(_ns(after_s), along[0]), Delay(_ns(clear_after_s), along[1])

    def alarm(self) -> Alarm:
        """As it stands."""
        clear = self.latch.state == "clear"
        return Alarm(
            name=self.name,
            severity=self.watch.severity,
            state=self.latch.state,
            value=self.finding.value,
            limit=self.finding.limit,
            unit=self.finding.unit,
            since_ns=self.latch.since_ns,
            detail="" if clear else self.detail,
            by=self.latch.by,
        )


class AlarmBoard:
    """Every alarm as it stands; told of readings from one thread, asked and acknowledged from any.

    Delays run by the steady clock and the belt's travel; the system clock is only noted down. What stands is not
    kept over a restart: what still holds then is raised again.
    """

    def __init__(self, settings: AlarmSettings) -> None:
        self._settings = settings
        self._lock = Lock()
        self._entries: dict[str, _Entry] = {}
        self._alarms: dict[str, Alarm] = {}
        self._steady_ns: int | None = None
        self._belt_mm = _NAN

    def update(self, readings: Readings, wall_ns: int, steady_ns: int) -> tuple[Alarm, ...]:
        """Take in the readings of a moment; the alarms whose state changed by them."""
        with self._lock:
            step = self._step(readings, steady_ns)
            changed: list[Alarm] = []
            seen: set[str] = set()
            for kind, rule in RULES.items():
                watch: Watch = getattr(self._settings, kind)
                for subject, finding in rule(readings, self._settings).items() if watch.enabled else ():
                    entry = self._entry(kind, subject, watch)
                    seen.add(entry.name)
                    if entry.look(_judged(entry, finding), step, wall_ns):
                        changed.append(entry.alarm())
            for name, entry in self._entries.items():
                if name not in seen:  # a camera nobody told of this time
                    entry.look(Finding("unknown"), step, wall_ns)
            self._show()
            return tuple(changed)

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """All of them, also the clear ones, in a fixed order; cameras in the order in which they came."""
        with self._lock:
            return tuple(self._alarms.values())

    def acknowledge(self, name: str, by: str, wall_ns: int) -> bool:  # noqa: ARG002  (for the caller's log)
        """Somebody has seen the alarm of that name; False where it is clear, seen already, or unknown."""
        with self._lock:
            entry = self._entries.get(name)
            if entry is None or not entry.latch.acknowledge(by):
                return False
            self._show()
            return True

    def _entry(self, kind: str, subject: str, watch: Watch) -> _Entry:
        entry = _Entry(kind, subject, watch)
        return self._entries.setdefault(entry.name, entry)

    def _step(self, readings: Readings, steady_ns: int) -> Step:
        """What passed since the last update; a belt whose place is not known has not moved."""
        time_ns = 0 if self._steady_ns is None else max(0, steady_ns - self._steady_ns)
        self._steady_ns = steady_ns if self._steady_ns is None else max(steady_ns, self._steady_ns)
        moved = readings.belt_mm - self._belt_mm
        if math.isfinite(readings.belt_mm):
            self._belt_mm = readings.belt_mm
        return Step(time_ns, max(0.0, moved) if math.isfinite(moved) else 0.0)

    def _show(self) -> None:
        order = {kind: place for place, kind in enumerate(RULES)}
        entries = sorted(self._entries.values(), key=lambda entry: order[entry.kind])
        self._alarms = {entry.name: entry.alarm() for entry in entries}


def _judged(entry: _Entry, finding: Finding) -> Finding:
    """A quantity that was never measured, such as the offset of a belt without ends, is not missed; the load is."""
    if not isinstance(entry.watch, NoMeasurement) or entry.known or finding.condition == "off":
        return finding
    if entry.subject == "load":
        return replace(finding, after_s=entry.watch.start_after_s)
    return Finding("unknown")


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)
