"""Events on their way to the history: alarms and what people did, with the parts of their texts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from beltscape.core.live.alarms import Alarm, AlarmState
from beltscape.core.live.translatable_message import get_key, get_values
from beltscape.pipeline.live.writer import BATCH, Writer
from beltscape.sinks.historian import Historian, NewEvent

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
