"""The alarms of a run: evaluated from readings, acknowledged and hidden by people, and journalled in the history.

Those that are present have a file: acknowledgements, latched and first alarms survive a restart.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from threading import Lock
from time import monotonic_ns, time_ns

from beltscape.alarms.board import AlarmBoard
from beltscape.alarms.readings import Readings
from beltscape.alarms.snapshot import BoardSnapshot, format_snapshot, parse_snapshot
from beltscape.core.alarm_catalogue import list_keys
from beltscape.core.alarms import Alarm
from beltscape.core.errors import InputError
from beltscape.core.interfaces import Observer
from beltscape.files.atomic import describe_refusal, read_state, write_durably
from beltscape.pipeline.live.event_log import EventLog
from beltscape.pipeline.live.hidden_alarms import HiddenAlarms

STATES_FILE = "alarm_states.json"


class AlarmStateFile:
    """Keeps the states of the alarms on the disk; one thread at a time uses it."""

    def __init__(self, folder: Path | None, on_message: Callable[[str], object] = lambda _: None) -> None:
        """Keep them in ``folder``; None: nowhere. ``on_message`` gets a line when they cannot be read or written."""
        self._path = None if folder is None else folder / STATES_FILE
        self._on_message = on_message
        self._trouble = ""
        self._status: tuple[object, ...] | None = None

    def read(self) -> BoardSnapshot:
        """Return the states that a run before has left; none where there is no such file, or it is damaged."""
        if self._path is None:
            return BoardSnapshot()
        instead = "it is written anew, and alarms must be acknowledged again"
        found, trouble = read_state(self._path, parse_snapshot, instead)
        if trouble:
            self._on_message(trouble)
        return found or BoardSnapshot()

    def write(self, snapshot: BoardSnapshot) -> None:
        """Put the states durably on the disk if a restart must not lose what has changed since the last time.

        A disk that refuses them causes a message, and is tried again by the next call; alarms go on without it.
        """
        if self._path is None or snapshot.status == self._status:
            return
        try:
            write_durably(self._path, format_snapshot(snapshot))
        except OSError as error:
            trouble = f"{self._path}: {describe_refusal(error)}; a restart would lose acknowledgements"
            if trouble != self._trouble:
                self._on_message(trouble)
            self._trouble = trouble
            return
        self._status, self._trouble = snapshot.status, ""


class AlarmControl:
    """Connects the board with the journal, the hidden alarms and the observers; implements `AlarmControls`."""

    def __init__(
        self,
        board: AlarmBoard,
        hidden_alarms: HiddenAlarms,
        events: EventLog,
        observer: Observer,
        keep_frames: Callable[[str], object],
        states: AlarmStateFile,
        cameras: tuple[str, ...] = (),
    ) -> None:
        """Join them; ``keep_frames`` keeps the recording ring for a critical alarm."""
        self._states, self._cameras, self._saving = states, cameras, Lock()
        self._board, self._hidden_alarms = board, hidden_alarms
        self._events, self._observer, self._keep_frames = events, observer, keep_frames
        board.hide(hidden_alarms.hidden)

    def start(self) -> None:
        """Continue the alarms of the run before, and note them in the journal with the hidden ones."""
        self._board.restore(self._states.read(), self._cameras)
        self._save()
        hidden = sorted(self._hidden_alarms.hidden)
        present = [
            alarm.name for alarm in self._board.alarms if {alarm.state, alarm.hidden_state} != {"clear"}
        ]
        text = f"the program starts; present: {', '.join(present) or 'none'}; hidden: {', '.join(hidden) or 'none'}"
        parameters = {"action": "start", "hidden": hidden, "present": present}
        self._events.add("alarm", "journal", text, time_ns(), parameters=parameters)
        self._observer.on_alarms(self._board.alarms)

    def update(self, readings: Readings) -> None:
        """Evaluate the alarms and journal every change, also of a hidden one."""
        wall_ns = time_ns()
        for name in self._hidden_alarms.remove_ended():
            self._events.add("alarm", name, "shelving ends", wall_ns, parameters={"action": "unshelved"})
            self._show(name)
        for alarm in self._board.update(readings, wall_ns, monotonic_ns()):
            self._events.add_alarm(alarm, wall_ns)
            if alarm.state == "raised" and alarm.severity == "critical":
                self._keep_frames(alarm.name)
        self._save()
        self._observer.on_alarms(self._board.alarms)

    def acknowledge(self, alarm: str, by: str) -> bool:
        """Acknowledge an alarm; return whether there was one to acknowledge."""
        wall_ns = time_ns()
        if not self._board.acknowledge(alarm, by, wall_ns):
            return False
        self._events.add("alarm", alarm, "acknowledged", wall_ns, by, {"state": "acknowledged"})
        self._save()
        self._observer.on_alarms(self._board.alarms)
        return True

    @property
    def shelving_max_min(self) -> float:
        """Longest time for which an alarm may be shelved, in minutes."""
        return self._board.settings.shelving.max_min

    @property
    def own_texts(self) -> Mapping[str, Mapping[str, Mapping[str, str]]]:
        """The plant's own texts: title and detail by language and alarm; empty: the program's."""
        return self._board.texts.to_mapping()

    def shelve(self, alarm: str, reason: str, minutes: float, by: str) -> None:
        """Hide an alarm for a time, or set reason and end anew; InputError where it must not be."""
        present = self._require(alarm)
        if any(key in self._board.settings.shelving.never for key in list_keys(alarm)):
            raise InputError(f"{alarm}: must not be shelved: [alarms.shelving] never has it")
        if not 0 < minutes <= self._board.settings.shelving.max_min:
            raise InputError(
                f"{minutes:g} min: longer than [alarms.shelving] max_min = {self._board.settings.shelving.max_min:g}"
            )
        if present.suppression is not None and present.suppression.kind == "out_of_service":
            raise InputError(f"{alarm}: is out of service; return it to service first")
        shelved = self._hidden_alarms.shelve(alarm, reason, minutes, by)
        until_ms = (shelved.until_ns or 0) // 1_000_000
        parameters = {"action": "shelved", "reason": reason, "minutes": minutes, "until_ms": until_ms}
        self._events.add("alarm", alarm, f"shelved for {minutes:g} min: {reason}", time_ns(), by, parameters)
        self._hide()

    def take_out_of_service(self, alarm: str, reason: str, by: str) -> None:
        """Hide an alarm until it is returned to service."""
        self._require(alarm)
        self._hidden_alarms.take_out_of_service(alarm, reason, by)
        parameters = {"action": "out_of_service", "reason": reason}
        self._events.add("alarm", alarm, f"out of service: {reason}", time_ns(), by, parameters)
        self._hide()

    def return_to_service(self, alarm: str, by: str) -> None:
        """Show an alarm again; InputError if it is not hidden by a person."""
        removed = self._hidden_alarms.remove(alarm)
        if removed is None:
            raise InputError(f"{alarm}: is neither shelved nor out of service")
        action = "unshelved" if removed.kind == "shelved" else "in_service"
        text = "shelving ended" if removed.kind == "shelved" else "in service again"
        self._events.add("alarm", alarm, text, time_ns(), by, {"action": action})
        self._show(alarm)
        self._save()
        self._observer.on_alarms(self._board.alarms)

    def reset(self, alarm: str, by: str) -> None:
        """Reset an alarm that has latched and is acknowledged; InputError if it is not such a one."""
        self._require(alarm)
        if not self._board.reset(alarm):
            raise InputError(f"{alarm}: has not latched, or is not acknowledged yet")
        self._events.add("alarm", alarm, "reset", time_ns(), by, {"action": "reset", "state": "clear"})
        self._save()
        self._observer.on_alarms(self._board.alarms)

    def _require(self, alarm: str) -> Alarm:
        present = self._board.get(alarm)
        if present is None:
            raise InputError(f"{alarm}: there is no alarm of that name")
        return present

    def _hide(self) -> None:
        self._board.hide(self._hidden_alarms.hidden)
        self._save()
        self._observer.on_alarms(self._board.alarms)

    def _save(self) -> None:
        """Keep the present states; what an observer or a caller then learns is on the disk."""
        with self._saving:
            self._states.write(self._board.snapshot(self._cameras))

    def _show(self, alarm: str) -> None:
        """Show an alarm that was hidden, and journal it where its condition holds."""
        self._board.hide(self._hidden_alarms.hidden)
        present = self._board.get(alarm)
        if present is not None and present.state != "clear":
            self._events.add_alarm(present, time_ns())
