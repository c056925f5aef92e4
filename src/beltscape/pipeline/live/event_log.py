"""Events and findings on their way to the history.

Events are alarms and what people did, with the parts of their texts. Of the findings about one a second and check is
stored, and every change of a fault.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from time import monotonic, time_ns

from beltscape.core.alarms import Alarm, AlarmState
from beltscape.core.errors import BeltscapeError
from beltscape.core.findings import Finding
from beltscape.core.translatable_message import get_key, get_values
from beltscape.pipeline.live.writer import BATCH, Writer
from beltscape.sinks.historian import Historian, NewEvent, StoredFinding

_CAPACITY = 20_000
"""Most waiting events, which bounds the memory: one alarm in 4 s while a history is not written for a day. Chosen."""
_PATIENCE_S = 1.0
"""Longest time for which a person's action waits until its event is on the disk. Chosen."""


class EventLog:
    """Stores events in the history, in a thread of its own: neither a frame nor an alarm waits for the disk.

    Those that the history refuses, such as while another program holds it, wait and are stored later, in their order.
    """

    def __init__(self, historian: Historian) -> None:
        self._writer = Writer("events", _Journal(historian), bound=_drop_oldest)

    def add(
        self,
        kind: str,
        name: str,
        text: str,
        wall_ns: int,
        by: str = "",
        parameters: Mapping[str, object] | None = None,
    ) -> None:
        """Store an event; ``parameters`` are the parts from which a page composes its text in any language.

        That of a person, ``by``, is on the disk when this returns, unless that takes longer than a second.
        """
        self._writer.put((NewEvent(kind, name, text, wall_ns, by, parameters),))
        if by:
            self._writer.wait(_PATIENCE_S)

    @property
    def trouble(self) -> str:
        """Why events wait, in one line; empty while they are stored."""
        return self._writer.trouble

    def wait(self, seconds: float) -> bool:
        """Wait until all events are stored; return whether they are in time."""
        return self._writer.wait(seconds)

    def close(self) -> int:
        """Store the waiting events; return how many were not stored in time."""
        return self._writer.close()

    def add_alarm(self, alarm: Alarm, wall_ns: int) -> None:
        """Store the change of an alarm."""
        state = alarm.state if alarm.suppression is None else alarm.hidden_state
        hidden = "" if alarm.suppression is None else f" ({alarm.isa_state}: {alarm.suppression.reason})"
        text = f"{state}{hidden}: {alarm.detail}" if alarm.detail else f"{state}{hidden}"
        self.add("alarm", alarm.name, text, wall_ns, parameters=_list_parts(alarm, state))


class _Journal:
    """The history as the sink of events."""

    def __init__(self, historian: Historian) -> None:
        self._historian = historian

    def write(self, records: Sequence[NewEvent], /) -> None:
        """Store the events."""
        self._historian.add_events(records)


def _drop_oldest(waiting: list[NewEvent]) -> None:
    """Drop the oldest of too many events, without those that are being written."""
    del waiting[BATCH : BATCH + max(0, len(waiting) - _CAPACITY)]


def _list_parts(alarm: Alarm, state: AlarmState) -> dict[str, object]:
    numbers = {"value": alarm.value, "limit": alarm.limit}
    known = {name: value for name, value in numbers.items() if math.isfinite(value)}
    parts: dict[str, object] = {"state": state, **known, "priority": alarm.priority}
    if alarm.suppression is not None:
        parts |= {"suppression": alarm.isa_state, "suppressed_by": alarm.suppression.reason}
    if alarm.is_first:
        parts |= {"first": True, "group": alarm.group}
    if known:
        parts["unit"] = alarm.unit
    if get_key(alarm.detail):
        parts |= {"cause": get_key(alarm.detail), "values": get_values(alarm.detail)}
    return parts


_PERIOD_S = 1.0
"""Shortest time between two stored findings of a check without a change of its fault."""
_LONGEST_S = 10.0
"""A finding that has hardly changed is stored after this time."""
_UNCHANGED_SIGMAS = 0.5
"""A change by less than this share of σ is none; the noise of most checks exceeds it."""
_FINDINGS_CAPACITY = 20_000
"""Most waiting findings; beyond it the oldest are lost, which bounds the memory while the disk fails."""


class FindingLog:
    """Selects the findings that are stored, on the worker's thread; stores them on another."""

    def __init__(
        self, monotonic_s: Callable[[], float] = monotonic, wall_ns: Callable[[], int] = time_ns
    ) -> None:
        self._monotonic_s, self._wall_ns = monotonic_s, wall_ns
        self._last: dict[tuple[str, str], tuple[float, Finding]] = {}
        self._waiting: deque[StoredFinding] = deque(maxlen=_FINDINGS_CAPACITY)
        self._lock = threading.Lock()

    def put(self, findings: Sequence[Finding]) -> None:
        """Add the findings of one frame set; returns at once."""
        now_s, wall_ns = self._monotonic_s(), self._wall_ns()
        with self._lock:
            for finding in findings:
                key = (finding.check, finding.subject)
                last = self._last.get(key)
                if last is None or _is_due(finding, last[1], now_s - last[0]):
                    self._last[key] = now_s, finding
                    self._waiting.append(StoredFinding(wall_ns, finding))

    def store(self, historian: Historian) -> None:
        """Store the waiting findings; those that the disk refuses wait for the next call."""
        with self._lock:
            waiting = list(self._waiting)
            self._waiting.clear()
        try:
            historian.add_findings(waiting)
        except BeltscapeError:  # the historian's own trouble is an alarm
            with self._lock:
                self._waiting.extendleft(reversed(waiting[-_FINDINGS_CAPACITY + len(self._waiting) :]))


def _is_due(finding: Finding, last: Finding, elapsed_s: float) -> bool:
    """Return whether a finding is stored that follows ``last`` after ``elapsed_s``."""
    if (finding.is_fault, finding.effect, finding.cause) != (last.is_fault, last.effect, last.cause):
        return True
    if elapsed_s < _PERIOD_S:
        return False
    if elapsed_s >= _LONGEST_S or math.isfinite(finding.value) != math.isfinite(last.value):
        return True
    return not abs(finding.value - last.value) <= _UNCHANGED_SIGMAS * finding.sigma
