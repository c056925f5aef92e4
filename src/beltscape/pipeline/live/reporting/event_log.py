"""Events on their way to the history: alarms and what people did, with the parts of their texts."""

from __future__ import annotations

import math
from collections.abc import Mapping

from beltscape.core.errors import BeltscapeError
from beltscape.core.live.alarms import Alarm, AlarmState
from beltscape.core.live.translatable_message import get_key, get_values
from beltscape.core.progress import Reporter
from beltscape.sinks.historian import Historian


class EventLog:
    """Stores events in the history; a disk that refuses one causes a warning only."""

    def __init__(self, historian: Historian, reporter: Reporter) -> None:
        self._historian, self._reporter = historian, reporter

    def add(
        self,
        kind: str,
        name: str,
        text: str,
        wall_ns: int,
        by: str = "",
        parameters: Mapping[str, object] | None = None,
    ) -> None:
        """Store an event; ``parameters`` are the parts from which a page composes its text in any language."""
        try:
            self._historian.add_event(kind, name, text, by=by, wall_ns=wall_ns, parameters=parameters)
        except BeltscapeError as error:
            self._reporter.warn(f"{kind} {name} {text}: not stored: {error}")

    def add_alarm(self, alarm: Alarm, wall_ns: int) -> None:
        """Store the change of an alarm."""
        state = alarm.state if alarm.suppression is None else alarm.hidden_state
        hidden = "" if alarm.suppression is None else f" ({alarm.isa_state}: {alarm.suppression.reason})"
        text = f"{state}{hidden}: {alarm.detail}" if alarm.detail else f"{state}{hidden}"
        self.add("alarm", alarm.name, text, wall_ns, parameters=_list_parts(alarm, state))


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
