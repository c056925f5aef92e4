"""The file of the alarms that are present: acknowledgements, latched and first alarms survive a restart."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from beltscape.alarms.management.snapshot import BoardSnapshot, format_snapshot, parse_snapshot
from beltscape.files.folders.durable import describe_refusal, read_state, write_durably

FILE = "alarm_states.json"


class AlarmStateFile:
    """Keeps the states of the alarms on the disk; one thread at a time uses it."""

    def __init__(self, folder: Path | None, on_message: Callable[[str], object] = lambda _: None) -> None:
        """Keep them in ``folder``; None: nowhere. ``on_message`` gets a line when they cannot be read or written."""
        self._path = None if folder is None else folder / FILE
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
