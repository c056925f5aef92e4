"""The management of alarms by ANSI/ISA-18.2 and IEC 62682: priorities, first-out and suppression by design.

The default priority of an alarm follows from two estimates, as the rationalization of ANSI/ISA-18.2 and EEMUA 191
asks for: what happens if nobody acts, and how soon it happens; `core.alarm_catalogue` has them. A plant whose
estimates differ sets the priority itself. First-out names the alarm of a group with common causes that came first.
Alarms that say nothing new while the plant is in a state that explains them are suppressed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from beltscape.core.alarm_catalogue import CAMERAS_OFF, DEFINITIONS, FAULT, Rationale, list_keys, split_name
from beltscape.core.alarms import Priority


def get_rationale(name: str) -> Rationale:
    """Return the estimates for an alarm; those of a fault for one that an older program named."""
    definition = DEFINITIONS.get(split_name(name)[0])
    return FAULT if definition is None else definition.rationale


def select_priority(name: str, chosen: Mapping[str, Priority]) -> Priority:
    """Return the priority of an alarm: the plant's choice for its name or its kind, else the default."""
    for key in list_keys(name):
        if key in chosen:
            return chosen[key]
    return get_rationale(name).priority


def find_group(name: str, groups: Mapping[str, Sequence[str]]) -> tuple[str, int]:
    """Return the group of an alarm and its place there; an empty name where no group has it."""
    for key in list_keys(name):
        for group, members in groups.items():
            if key in members:
                return group, members.index(key)
    return "", 0


@dataclass(frozen=True, slots=True)
class GroupMember:
    """An alarm of a group at one moment."""

    name: str
    group: str
    place: int
    """Its place in the group's list."""
    onset_ns: int
    """Steady clock when its condition began, before the delay that raised it."""


@dataclass(slots=True)
class FirstOut:
    """The alarm that came first in each group, from the moment the group has an alarm until all of it are clear.

    The alarm whose condition began first is marked, even where its delay is longer than that of its consequences.
    It stays the first when it clears before them.
    """

    _first: dict[str, GroupMember] = field(default_factory=dict[str, GroupMember])

    def update(self, present: Iterable[GroupMember]) -> None:
        """Apply the alarms that are not clear now."""
        members = [member for member in present if member.group]
        for group in set(self._first) - {member.group for member in members}:
            del self._first[group]
        for member in members:
            first = self._first.get(member.group, member)
            self._first[member.group] = min(first, member, key=lambda one: (one.onset_ns, one.place))

    @property
    def names(self) -> dict[str, str]:
        """Return the name of the first alarm by group."""
        return {group: member.name for group, member in self._first.items()}

    def restore(self, firsts: Iterable[GroupMember]) -> None:
        """Continue with the first alarms of a run before."""
        self._first = {member.group: member for member in firsts}

    def has(self, name: str) -> bool:
        """Return whether an alarm came first in its group."""
        return any(member.name == name for member in self._first.values())


def select_state(
    name: str,
    states: Sequence[str],
    suppressed: Mapping[str, Collection[str]],
    off_cameras: Collection[str],
    cameras: Collection[str],
) -> str:
    """Return the state of the plant that suppresses an alarm; empty: none does.

    ``suppressed`` has the alarms of every state. An alarm of one camera is suppressed with a bank of cameras only if
    the camera belongs to it (``off_cameras``); ``cameras`` are all.
    """
    subject = split_name(name)[1]
    for state in states:
        if not any(key in suppressed[state] for key in list_keys(name)):
            continue
        if state == CAMERAS_OFF and subject in cameras and subject not in off_cameras:
            continue
        return state
    return ""
