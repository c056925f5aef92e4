"""Alarms that people have hidden: shelved for a time, or out of service. They survive a restart."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from time import monotonic, time_ns

from pydantic import TypeAdapter

from beltscape.core.alarms import Suppression
from beltscape.files.atomic import describe_refusal, read_state, write_durably

FILE = "alarms.json"
_MINUTE_S, _S_NS = 60.0, 1_000_000_000
"""Seconds of a minute, and nanoseconds of a second."""
_NEVER_S = float("inf")


class HiddenAlarms:
    """The alarms that people have hidden, by name; changed and read from any thread.

    The time of shelving runs by the monotonic clock; after a restart, by the system clock that the file states.
    """

    def __init__(
        self,
        folder: Path | None,
        monotonic_s: Callable[[], float] = monotonic,
        wall_ns: Callable[[], int] = time_ns,
        on_message: Callable[[str], object] = lambda _: None,
    ) -> None:
        """Continue with the alarms that a run before has left in ``folder``; None: nothing is kept.

        ``on_message`` gets a line when they cannot be read or written.
        """
        self._path = None if folder is None else folder / FILE
        self._monotonic_s, self._wall_ns = monotonic_s, wall_ns
        self._lock = threading.Lock()
        self._hidden: dict[str, Suppression] = {}
        self._end_s: dict[str, float] = {}
        self._on_message = on_message
        self._read()

    @property
    def hidden(self) -> Mapping[str, Suppression]:
        """The hidden alarms by name."""
        with self._lock:
            return dict(self._hidden)

    def shelve(self, name: str, reason: str, minutes: float, by: str) -> Suppression:
        """Shelve an alarm, or set its reason and end anew."""
        now_ns = self._wall_ns()
        until_ns = now_ns + round(minutes * _MINUTE_S) * _S_NS
        end_s = self._monotonic_s() + minutes * _MINUTE_S
        return self._put(name, Suppression("shelved", reason, by, now_ns, until_ns), end_s)

    def take_out_of_service(self, name: str, reason: str, by: str) -> Suppression:
        """Hide an alarm until it is removed."""
        return self._put(name, Suppression("out_of_service", reason, by, self._wall_ns()), _NEVER_S)

    def remove(self, name: str) -> Suppression | None:
        """Show an alarm again; return why it was hidden, None if it was not."""
        with self._lock:
            removed = self._hidden.pop(name, None)
            self._end_s.pop(name, None)
            if removed is not None:
                self._write()
            return removed

    def remove_ended(self) -> dict[str, Suppression]:
        """Show the alarms again whose time is over; return why they were hidden."""
        now_s = self._monotonic_s()
        with self._lock:
            ended = {name: self._hidden.pop(name) for name, end_s in self._end_s.items() if now_s >= end_s}
            for name in ended:
                del self._end_s[name]
            if ended:
                self._write()
            return ended

    def _put(self, name: str, suppression: Suppression, end_s: float) -> Suppression:
        with self._lock:
            self._hidden[name], self._end_s[name] = suppression, end_s
            self._write()
            return suppression

    def _read(self) -> None:
        if self._path is None:
            return
        hidden, trouble = read_state(self._path, _parse, "no alarm is shelved or out of service now")
        if trouble:
            self._on_message(trouble)
        for name, suppression in (hidden or {}).items():
            self._hidden[name] = suppression
            self._end_s[name] = self._compute_end_s(suppression)

    def _compute_end_s(self, suppression: Suppression) -> float:
        if suppression.until_ns is None:
            return _NEVER_S
        left_s = (suppression.until_ns - self._wall_ns()) / _S_NS
        # a clock that was set back does not lengthen it
        length_s = (suppression.until_ns - suppression.since_ns) / _S_NS
        return self._monotonic_s() + min(left_s, length_s)

    def _write(self) -> None:
        """Keep the alarms on the disk; without it a restart would show them, so a failure is not fatal."""
        if self._path is None:
            return
        text = json.dumps({name: asdict(one) for name, one in self._hidden.items()}, indent=1)
        try:
            write_durably(self._path, text.encode())
        except OSError as error:
            self._on_message(f"{self._path}: {describe_refusal(error)}; a restart would show hidden alarms")


def _parse(text: bytes) -> dict[str, Suppression]:
    """Return the alarms of a file; ValueError where they cannot be hidden by people."""
    hidden = TypeAdapter(dict[str, Suppression]).validate_json(text)
    for name, one in hidden.items():
        if one.kind == "by_state" or (one.kind == "shelved") != (one.until_ns is not None):
            raise ValueError(f"{name}: neither shelved for a time nor out of service")
    return hidden
