"""The board of all alarms: readings in, alarms and their changes out."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from threading import Lock

from beltscape.alarms.entry import AlarmEntry, make_name
from beltscape.alarms.management import FirstOut, GroupMember, find_group, select_priority, select_state
from beltscape.alarms.readings import Readings
from beltscape.alarms.rules import RULES, Conditions
from beltscape.alarms.settings import AlarmSettings, CommonSettings, NoMeasurement
from beltscape.alarms.snapshot import BoardSnapshot, SavedAlarm
from beltscape.alarms.state_machine import AlarmCondition, Elapsed, condition_from_finding
from beltscape.alarms.texts import CustomTexts
from beltscape.core.alarm_catalogue import (
    BELT_STOPPED,
    CAMERA_LOST,
    CAMERAS_OFF,
    CHECKS,
    DEFINITIONS,
    ENCODER_SILENT,
    ENCODER_WRONG,
    FRAMES_DROPPED,
    MAINTENANCE,
    list_keys,
    split_name,
)
from beltscape.core.alarms import PRIORITIES, Alarm, Suppression

_NAN = float("nan")
_State = tuple[str, str]
"""State that is shown, state of the machine."""


@dataclass(slots=True)
class _Clock:
    """Time and belt travel between updates; a belt at an unknown position has not moved."""

    steady_ns: int | None = None
    belt_mm: float = _NAN

    def advance(self, belt_mm: float, steady_ns: int) -> Elapsed:
        """Return what has passed since the previous update."""
        time_ns = 0 if self.steady_ns is None else max(0, steady_ns - self.steady_ns)
        self.steady_ns = steady_ns if self.steady_ns is None else max(steady_ns, self.steady_ns)
        travel_mm = belt_mm - self.belt_mm
        if math.isfinite(belt_mm):
            self.belt_mm = belt_mm
        return Elapsed(time_ns, max(0.0, travel_mm) if math.isfinite(travel_mm) else 0.0)


@dataclass(slots=True)
class _Changes:
    """The entries of the board with their states before an update."""

    before: dict[str, _State] = field(default_factory=dict[str, _State])

    def note(self, entries: Mapping[str, AlarmEntry]) -> None:
        """Take the states before the update."""
        self.before = {name: (entry.state, entry.machine.state) for name, entry in entries.items()}

    def has(self, entry: AlarmEntry) -> bool:
        """Return whether an entry has another state now."""
        return (entry.state, entry.machine.state) != self.before.get(entry.name, ("clear", "clear"))


class AlarmBoard:
    """All alarms; updated with readings by one thread, read, acknowledged and hidden from any.

    Delays run by the monotonic clock and the belt's travel; the system clock is only recorded. The states outlive a
    restart by `snapshot` and `restore`.
    """

    def __init__(self, settings: AlarmSettings, texts: CustomTexts | None = None) -> None:
        self._settings = settings
        self.texts = texts or CustomTexts()
        """The plant's own texts."""
        self._lock = Lock()
        self._entries: dict[str, AlarmEntry] = {}
        self._alarms: dict[str, Alarm] = {}
        self._clock = _Clock()
        self._changes = _Changes()
        self._first_out = FirstOut()
        self._suppressed = settings.suppression.by_state()
        self._hidden: Mapping[str, Suppression] = {}
        self._cause: AlarmEntry | None = None
        """The shown alarm because of which nothing is measured; None: there is none."""
        self._state_of: dict[str, Suppression | None] = {}

    @property
    def settings(self) -> AlarmSettings:
        """The settings by which alarms are evaluated."""
        return self._settings

    def set_settings(self, settings: AlarmSettings, texts: CustomTexts) -> None:
        """Evaluate by other settings and texts from now on; an alarm that they switch off is gone."""
        with self._lock:
            self._settings, self.texts = settings, texts
            self._suppressed = settings.suppression.by_state()
            before, self._entries = self._entries, {}
            for entry in before.values():
                own = self._select_settings(entry.kind, entry.subject)
                if own is not None:
                    self._entry(entry.kind, entry.subject, own).take_over(entry)
            self._refresh_alarms()

    def update(self, readings: Readings, wall_ns: int, steady_ns: int) -> tuple[Alarm, ...]:
        """Apply the readings of one moment; return the alarms whose state they changed, also a hidden one."""
        with self._lock:
            elapsed = self._clock.advance(readings.belt_mm, steady_ns)
            self._changes.note(self._entries)
            updated: set[str] = set()
            for entry, condition in self._evaluate(readings):
                updated.add(entry.name)
                entry.update(condition, elapsed, wall_ns, steady_ns)
            for name, entry in self._entries.items():
                if name not in updated:  # a camera without health in these readings
                    entry.update(AlarmCondition("unknown"), elapsed, wall_ns, steady_ns)
            self._suppress_by_state(readings)
            self._refresh_alarms()
            return tuple(self._alarms[e.name] for e in self._entries.values() if self._changes.has(e))

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """All alarms, also the clear ones, in a fixed order; cameras in the order of their first readings."""
        with self._lock:
            return tuple(self._alarms.values())

    def get(self, name: str) -> Alarm | None:
        """Return an alarm; None if it is not known."""
        with self._lock:
            return self._alarms.get(name)

    def snapshot(self, cameras: tuple[str, ...] = ()) -> BoardSnapshot:
        """Return the states that outlive a restart, with the cameras of this run."""
        with self._lock:
            entries = sorted(self._entries.values(), key=lambda entry: entry.onset_ns)
            saved = tuple(one for one in (entry.to_saved() for entry in entries) if one is not None)
            return BoardSnapshot(saved, self._first_out.names, cameras)

    def restore(self, snapshot: BoardSnapshot, cameras: Collection[str] = ()) -> None:
        """Continue the alarms of a run before; call it before the first update.

        An alarm is not continued where the settings switch it off, where this program has no alarm of its name, or
        where its camera or bank is gone. One that is no longer present clears by the first readings, as if the
        program had run all the time: at once or after an acknowledgement, as its settings say.
        """
        gone = set(snapshot.cameras) - set(cameras)
        with self._lock:
            for place, saved in enumerate(snapshot.alarms):
                kind, subject = split_name(saved.name)
                own = self._select_settings(kind, subject) if kind in DEFINITIONS else None
                if own is None or subject in gone:
                    continue
                self._restore_entry(saved, self._entry(kind, subject, own), place - len(snapshot.alarms))
            before_all = -1 - len(snapshot.alarms)
            self._first_out.restore(
                GroupMember(name, group, find_group(name, self._settings.groups)[1], before_all)
                for group, name in snapshot.first.items()
                if find_group(name, self._settings.groups)[0] == group
            )
            self._refresh_alarms()

    def _restore_entry(self, saved: SavedAlarm, entry: AlarmEntry, onset_ns: int) -> None:
        entry.restore(saved, onset_ns)
        if saved.state_of_plant:
            self._state_of[entry.name] = Suppression("by_state", saved.state_of_plant)
        entry.suppress(self._select_suppression(entry.name))

    def _select_settings(self, kind: str, subject: str) -> CommonSettings | None:
        """Return the settings of an alarm; None where they switch it off, or no longer have its bank of cameras."""
        is_fault = kind not in RULES
        own: CommonSettings = self._settings.select_fault(kind) if is_fault else getattr(self._settings, kind)
        has_bank = kind != CAMERAS_OFF or subject in (self._settings.cameras_off.banks or {""})
        return own if own.enabled and has_bank else None

    def acknowledge(self, name: str, by: str, wall_ns: int) -> bool:
        """Acknowledge the alarm ``name``; return False if it is clear, hidden, acknowledged already, or unknown."""
        with self._lock:
            entry = self._entries.get(name)
            if entry is None or entry.suppression is not None or not entry.machine.acknowledge(by, wall_ns):
                return False
            self._refresh_alarms()
            return True

    def reset(self, name: str) -> bool:
        """Reset the alarm ``name``; return False unless it has latched and is acknowledged and shown."""
        with self._lock:
            entry = self._entries.get(name)
            if entry is None or entry.suppression is not None or not entry.machine.reset():
                return False
            self._refresh_alarms()
            return True

    def hide(self, hidden: Mapping[str, Suppression]) -> None:
        """Hide the alarms of these names, and no others, because people want it."""
        with self._lock:
            self._hidden = dict(hidden)
            for entry in self._entries.values():
                entry.suppress(self._select_suppression(entry.name))
            self._refresh_alarms()

    def _evaluate(self, readings: Readings) -> Iterator[tuple[AlarmEntry, AlarmCondition]]:
        """Yield every alarm that the readings say something about, with its condition."""
        for kind, rule in RULES.items():
            settings: CommonSettings = getattr(self._settings, kind)
            conditions: Conditions = rule(readings, self._settings) if settings.enabled else {}
            for subject, condition in conditions.items():
                entry = self._entry(kind, subject, settings)
                yield entry, _without_unmeasured(entry, condition)
        for finding in readings.findings:
            settings = self._settings.select_fault(finding.check)
            is_known = make_name(finding.check, finding.subject) in self._entries
            if settings.enabled and (finding.is_fault or is_known):
                yield self._entry(finding.check, finding.subject, settings), condition_from_finding(finding)

    def _entry(self, kind: str, subject: str, settings: CommonSettings) -> AlarmEntry:
        name = make_name(kind, subject)
        if name not in self._entries:
            priority = select_priority(name, self._settings.priorities)
            group, place = find_group(name, self._settings.groups)
            self._entries[name] = AlarmEntry(
                kind, subject, settings, priority, group, place, self.texts, severity=settings.severity
            )
            self._entries[name].suppress(self._hidden.get(name))
        return self._entries[name]

    def _suppress_by_state(self, readings: Readings) -> None:
        """Suppress the alarms that the present state of the plant explains, and show the others again."""
        off_banks = {
            entry.subject
            for entry in self._entries.values()
            if entry.kind == CAMERAS_OFF and entry.machine.is_on
        }
        banks = self._settings.cameras_off.banks or {"": tuple(readings.cameras)}
        off_cameras = {name for bank in off_banks for name in banks.get(bank, ())}
        is_on = {entry.kind for entry in self._entries.values() if entry.machine.is_on}
        present = {
            MAINTENANCE: readings.is_maintained,
            BELT_STOPPED: BELT_STOPPED in is_on,
            CAMERAS_OFF: bool(off_banks),
            FRAMES_DROPPED: FRAMES_DROPPED in is_on,
            ENCODER_SILENT: ENCODER_SILENT in is_on,
            ENCODER_WRONG: ENCODER_WRONG in is_on,
        }
        states = [state for state, is_present in present.items() if is_present]
        self._cause = self._find_cause(readings.core)
        unmeasured = self._settings.suppression.unmeasured
        for name, entry in self._entries.items():
            state = select_state(name, states, self._suppressed, off_cameras, readings.cameras)
            if not state and self._cause is not None and not set(list_keys(name)).isdisjoint(unmeasured):
                state = self._cause.kind
            self._state_of[name] = Suppression("by_state", state) if state else None
            entry.suppress(self._select_suppression(name))

    def _find_cause(self, core: str | None) -> AlarmEntry | None:
        """Return the alarm that came first of those because of which nothing is measured; None: there is none.

        One that people have hidden explains nothing: then the load's own alarm is all that is shown.
        """
        lost = make_name(CAMERA_LOST, core or "")
        causes = [
            entry
            for name, entry in self._entries.items()
            if entry.machine.is_on
            and name not in self._hidden
            and (name == lost or (entry.kind in CHECKS and entry.present.severity == "critical"))
        ]
        return min(causes, key=lambda entry: entry.onset_ns, default=None)

    def _select_suppression(self, name: str) -> Suppression | None:
        """Return why an alarm is hidden: a person's reason stands before a state of the plant."""
        return self._hidden.get(name) or self._state_of.get(name)

    def _refresh_alarms(self) -> None:
        self._first_out.update(
            GroupMember(entry.name, entry.group, entry.place, entry.onset_ns)
            for entry in self._entries.values()
            if entry.state != "clear"
        )
        order = {kind: index for index, kind in enumerate(RULES)}
        entries = sorted(self._entries.values(), key=lambda entry: order.get(entry.kind, len(order)))
        hidden: dict[str, list[str]] = {}
        for entry in entries:
            if entry.suppression is not None and entry.machine.state != "clear":
                hidden.setdefault(entry.suppression.reason, []).append(entry.name)
        self._alarms = {
            entry.name: entry.to_alarm(
                is_first=self._first_out.has(entry.name),
                consequences=tuple(hidden.get(entry.kind, ())) if entry.state != "clear" else (),
            )
            for entry in entries
        }
        if self._cause is not None and self._cause.name in self._alarms:
            self._alarms[self._cause.name] = self._weight_cause(self._alarms[self._cause.name])

    def _weight_cause(self, cause: Alarm) -> Alarm:
        """Return the alarm because of which nothing is measured, as urgent as what it explains and hides."""
        hidden = [self._entries[name] for name in cause.consequences]
        priority = max((cause.priority, *(one.priority for one in hidden)), key=PRIORITIES.index)
        is_critical = any(one.severity == "critical" for one in hidden)
        return replace(cause, priority=priority, severity="critical" if is_critical else cause.severity)


def _without_unmeasured(entry: AlarmEntry, condition: AlarmCondition) -> AlarmCondition:
    """Return the condition; unknown for a quantity, other than the load, that has never been measured."""
    if not isinstance(entry.settings, NoMeasurement) or entry.was_off or condition.state == "off":
        return condition
    if entry.subject == "load":
        return replace(condition, after_s=entry.settings.start_after_s)
    return AlarmCondition("unknown")
