"""Alarms: their states, priorities and suppression, and what people do to them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

AlarmState = Literal["clear", "raised", "acknowledged", "gone", "latched"]
"""no alarm; on and not acknowledged; on and acknowledged; over and not acknowledged; acknowledged, to be reset"""
IsaState = Literal[
    "normal",
    "unacknowledged",
    "acknowledged",
    "returned_unacknowledged",
    "latched_unacknowledged",
    "latched_acknowledged",
    "shelved",
    "suppressed_by_design",
    "out_of_service",
]
"""The states A to I of the diagram of alarm states in ANSI/ISA-18.2-2016 and IEC 62682, in its order."""
Severity = Literal["info", "warning", "critical"]
Priority = Literal["low", "medium", "high", "urgent"]
PRIORITIES: tuple[Priority, ...] = ("low", "medium", "high", "urgent")
"""All priorities, from least to most."""
SuppressionKind = Literal["by_state", "shelved", "out_of_service"]
"""because of a state of the plant, by design; by an operator for a time; by an engineer until further notice"""


@dataclass(frozen=True, slots=True)
class Suppression:
    """Why an alarm is evaluated and journalled, but not shown."""

    kind: SuppressionKind
    reason: str
    """The state of the plant, such as "belt_stopped", or what the person wrote."""
    by: str = ""
    """Name of the user; empty for a state of the plant."""
    since_ns: int = 0
    """System clock when it began; 0 for a state of the plant."""
    until_ns: int | None = None
    """System clock when it ends by itself; None: it does not."""


_ISA_STATES: dict[AlarmState, IsaState] = {
    "clear": "normal",
    "raised": "unacknowledged",
    "acknowledged": "acknowledged",
    "gone": "returned_unacknowledged",
    "latched": "latched_acknowledged",
}
_ISA_SUPPRESSIONS: dict[SuppressionKind, IsaState] = {
    "by_state": "suppressed_by_design",
    "shelved": "shelved",
    "out_of_service": "out_of_service",
}


@dataclass(frozen=True, slots=True)
class Alarm:
    """One alarm in its present state."""

    name: str
    """Its key, such as "overload" or, for one camera, "camera_lost:cam2"."""
    severity: Severity
    state: AlarmState
    value: float
    """The value compared with the limit; NaN without one."""
    limit: float
    """The limit; NaN without one."""
    unit: str
    since_ns: int | None
    """System clock when it was raised; None while clear."""
    detail: str = ""
    """The fault and the fix in one line."""
    by: str = ""
    """Name of the user that acknowledged it; empty: nobody yet."""
    acknowledged_ns: int | None = None
    """System clock when it was acknowledged; None: not yet."""
    priority: Priority = "medium"
    """How soon the operator must act, and for what."""
    group: str = ""
    """Name of the group of alarms that have common causes; empty: none."""
    is_first: bool = False
    """Whether it came first in its group since all alarms of the group were clear (first-out)."""
    needs_reset: bool = False
    """Whether a person must reset it after its condition has ended."""
    suppression: Suppression | None = None
    """Why it is not shown; ``state`` is "clear" meanwhile. None: it is shown."""
    hidden_state: AlarmState = "clear"
    """The state that a suppressed alarm would have; "clear" without a suppression."""
    is_known: bool = True
    """Whether what it rests on is measured now; an unknown value neither raises nor clears an alarm."""
    consequences: tuple[str, ...] = ()
    """Names of the alarms that it explains, which are hidden meanwhile."""

    @property
    def isa_state(self) -> IsaState:
        """Return the state by the names of ANSI/ISA-18.2."""
        if self.suppression is not None:
            return _ISA_SUPPRESSIONS[self.suppression.kind]
        if self.state == "gone" and self.needs_reset:
            return "latched_unacknowledged"
        return _ISA_STATES[self.state]

    @property
    def is_listed(self) -> bool:
        """Return whether a list of what is present has it: shown, or hidden by a person."""
        return self.state != "clear" or (self.suppression is not None and self.suppression.kind != "by_state")


class AlarmControls(Protocol):
    """Actions of people on an alarm besides acknowledging it; InputError with one line where one is refused."""

    @property
    def shelving_max_min(self) -> float:
        """Longest time for which an alarm may be shelved, in minutes."""
        ...

    @property
    def own_texts(self) -> Mapping[str, Mapping[str, Mapping[str, str]]]:
        """The plant's own texts: title and detail by language and alarm; empty: the program's."""
        ...

    def shelve(self, alarm: str, reason: str, minutes: float, by: str) -> None:
        """Hide the alarm for a time, or set reason and end anew."""
        ...

    def take_out_of_service(self, alarm: str, reason: str, by: str) -> None:
        """Hide the alarm until it is returned to service."""
        ...

    def return_to_service(self, alarm: str, by: str) -> None:
        """End the shelving of the alarm, or return it to service."""
        ...

    def reset(self, alarm: str, by: str) -> None:
        """Reset the alarm that has latched and is acknowledged."""
        ...
