"""Maintenance mode: while people work at the system, the belt that passes is missing. It survives a restart."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from time import monotonic, time_ns

from pydantic import TypeAdapter

from beltscape.core.alarm_catalogue import MAINTENANCE
from beltscape.core.events import Maintenance
from beltscape.core.findings import Finding
from beltscape.core.translatable_message import make_message
from beltscape.files.atomic import describe_refusal, read_state, write_durably
from beltscape.sinks.historian import Event

FILE = "maintenance.json"
_LIMIT = 0.5
"""Between the two values of its finding."""
_MINUTE_S, _S_NS = 60.0, 1_000_000_000
"""Seconds of a minute, and nanoseconds of a second."""
_MAINTENANCE = TypeAdapter(Maintenance)


class MaintenanceMode:
    """The present maintenance, if any; begun and ended from any thread.

    Its time runs by the monotonic clock; after a restart, by the system clock that the file states.
    """

    def __init__(
        self,
        folder: Path | None,
        monotonic_s: Callable[[], float] = monotonic,
        wall_ns: Callable[[], int] = time_ns,
        on_message: Callable[[str], object] = lambda _: None,
        recover: Callable[[], Maintenance | None] = lambda: None,
    ) -> None:
        """Continue the maintenance that a run before has left in ``folder``; None: nothing is kept.

        ``on_message`` gets a line when it cannot be read or written; ``recover`` finds it where its file is damaged.
        """
        self._on_message = on_message
        self._path = None if folder is None else folder / FILE
        self._monotonic_s, self._wall_ns = monotonic_s, wall_ns
        self._lock = threading.Lock()
        self._current: Maintenance | None = None
        self._end_s = float("-inf")
        self._read(recover)

    def begin(self, reason: str, minutes: float, by: str) -> Maintenance:
        """Begin maintenance, or set its reason and end anew."""
        now_ns = self._wall_ns()
        with self._lock:
            since_ns = now_ns if self._current is None else self._current.since_ns
            self._current = Maintenance(reason, by, since_ns, now_ns + round(minutes * _MINUTE_S) * _S_NS)
            self._end_s = self._monotonic_s() + minutes * _MINUTE_S
            self._write()
            return self._current

    def end(self) -> Maintenance | None:
        """End maintenance; return the one that ended, None if there was none."""
        with self._lock:
            ended, self._current = self._current, None
            self._write()
            return ended

    @property
    def current(self) -> Maintenance | None:
        """The present maintenance, also when its time is over; None without one."""
        return self._current

    @property
    def is_over(self) -> bool:
        """True if the time of the present maintenance has passed."""
        with self._lock:
            return self._current is not None and self._monotonic_s() >= self._end_s

    def _read(self, recover: Callable[[], Maintenance | None]) -> None:
        if self._path is None:
            return
        kept, trouble = read_state(
            self._path, _MAINTENANCE.validate_json, "the history says whether there is any"
        )
        if trouble:
            self._on_message(trouble)
            kept = recover()
        if kept is None:
            return
        left_s = (kept.until_ns - self._wall_ns()) / _S_NS
        # a clock that was set back does not lengthen it
        self._end_s = self._monotonic_s() + min(left_s, (kept.until_ns - kept.since_ns) / _S_NS)
        self._current = kept
        if trouble:
            self._write()

    def _write(self) -> None:
        """Keep the state on the disk; without it a restart would measure, so a failure is not fatal."""
        if self._path is None:
            return
        try:
            if self._current is None:
                self._path.unlink(missing_ok=True)
            else:
                write_durably(self._path, json.dumps(asdict(self._current)).encode())
        except OSError as error:
            self._on_message(
                f"{self._path}: {describe_refusal(error)}; a restart would not know of maintenance"
            )


def recover_maintenance(events: Sequence[Event]) -> Maintenance | None:
    """Return the maintenance that the newest event about any has begun; None where it has ended, or none is there."""
    newest = next((one for one in events if one.kind == MAINTENANCE), None)
    if newest is None or newest.name != "begin":
        return None
    try:
        parts = json.loads(newest.parameters)
        until_ns = newest.wall_ns + round(float(parts["minutes"]) * _MINUTE_S) * _S_NS
        return Maintenance(str(parts["reason"]), newest.by, newest.wall_ns, until_ns)
    except (ValueError, KeyError, TypeError):
        return None


def make_maintenance_finding(maintenance: Maintenance | None) -> Finding:
    """Return the finding of a frame: 1 and "missing" during maintenance, which makes its belt missing, else 0."""
    if maintenance is None:
        return Finding(MAINTENANCE, 0.0, 0.0, _LIMIT, "")
    text = make_message("maintenance", detail=maintenance.reason)
    return Finding(MAINTENANCE, 1.0, 0.0, _LIMIT, "", text=text, effect="missing")
