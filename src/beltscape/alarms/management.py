"""The management of alarms by ANSI/ISA-18.2 and IEC 62682: priorities, first-out and suppression by design.

The default priority of an alarm follows from two estimates, as the rationalization of ANSI/ISA-18.2 and EEMUA 191
asks for: what happens if nobody acts, and how soon it happens. A plant whose estimates differ sets the priority
itself. First-out names the alarm of a group with common causes that came first. Alarms that say nothing new while
the plant is in a state that explains them are suppressed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from beltscape.alarms.names import list_keys, split_name
from beltscape.core.alarms import Priority

Consequence = Literal["minor", "major", "severe"]
"""work or comfort; measured values lost or wrong; damage to the belt or an interruption of the plant"""
Response = Literal["slow", "soon", "prompt"]
"""more than 30 minutes; 5 to 30 minutes; less than 5 minutes until the consequence"""

MATRIX: Mapping[Consequence, Mapping[Response, Priority]] = {
    "minor": {"slow": "low", "soon": "low", "prompt": "medium"},
    "major": {"slow": "low", "soon": "medium", "prompt": "high"},
    "severe": {"slow": "medium", "soon": "high", "prompt": "urgent"},
}
"""Priority by consequence and time; most alarms come out low, as EEMUA 191 advises (about 80, 15 and 5 %)."""


@dataclass(frozen=True, slots=True)
class Rationale:
    """The estimates behind a default priority."""

    consequence: Consequence
    response: Response
    """Time until the consequence."""

    @property
    def priority(self) -> Priority:
        """Return the priority that follows from both."""
        return MATRIX[self.consequence][self.response]


_FAULT = Rationale("major", "soon")
"""Of a check's fault: values are wrong or missing until it is repaired; the check itself marks the belt meanwhile."""
RATIONALES: Mapping[str, Rationale] = {
    "no_measurement": Rationale("major", "prompt"),  # belt passes uncounted
    "overload": Rationale("severe", "prompt"),  # spillage, blocked transfer, overloaded drive
    "oversize_lump": Rationale("severe", "prompt"),  # the next transfer blocks
    "misaligned_belt": Rationale("severe", "soon"),  # the belt's edge wears on the structure
    "belt_stopped": Rationale("minor", "slow"),  # the control system knows it as well
    "empty": Rationale("minor", "slow"),
    "low_coverage": Rationale("major", "soon"),  # the volume's uncertainty grows
    "cameras_off": Rationale("major", "prompt"),  # belt passes uncounted
    "camera_lost": Rationale("major", "soon"),  # the other cameras go on
    "camera_skew": Rationale("major", "soon"),
    "frames_dropped": Rationale("major", "prompt"),  # the cause of what it hides; belt may pass uncounted
    "disk_full": Rationale("major", "prompt"),  # the reserve is finite
    "history_repaired": Rationale("minor", "slow"),
    "users_unreadable": Rationale("minor", "soon"),  # nobody can sign in
    "reports_failing": Rationale("minor", "soon"),  # the shift's paper is missing
    "recording_paused": Rationale("minor", "slow"),
    "encoder_silent": Rationale("major", "soon"),  # the material's own motion is less certain
    "encoder_wrong": Rationale("major", "soon"),
    "certificate_expiring": Rationale("minor", "slow"),
    "torn_edge_left": Rationale("severe", "soon"),  # a tear grows
    "torn_edge_right": Rationale("severe", "soon"),
    "camera_pose_unchecked": Rationale("minor", "soon"),  # nothing is known to be wrong
    "camera_redundancy": Rationale("minor", "slow"),
    "carry_back": Rationale("minor", "soon"),
    "carry_back_stuck": Rationale("minor", "soon"),
    "carry_back_total": Rationale("minor", "slow"),
    "condensation": Rationale("minor", "soon"),
    "dirt": Rationale("minor", "soon"),
    "dust": Rationale("minor", "soon"),
    "maintenance": Rationale("minor", "slow"),
    "splice": Rationale("minor", "slow"),
    "foreign_object": Rationale("severe", "soon"),  # a jammed lump blocks the transfer or cuts the belt
}
"""By kind of alarm; checks that are not named have the estimates of a fault. Chosen; every plant has its own."""


def get_rationale(name: str) -> Rationale:
    """Return the estimates for an alarm."""
    return RATIONALES.get(split_name(name)[0], _FAULT)


def select_priority(name: str, chosen: Mapping[str, Priority]) -> Priority:
    """Return the priority of an alarm: the plant's choice for its name or its kind, else the default."""
    for key in list_keys(name):
        if key in chosen:
            return chosen[key]
    return get_rationale(name).priority


GROUPS: Mapping[str, tuple[str, ...]] = {
    "images": (
        "cameras_off", "camera_lost", "lamp", "projector", "lens_covered", "sunlight", "overexposure", "exposure",
        "flicker", "condensation", "dirt", "dust", "defocus", "projector_focus", "frozen_image", "camera_sync",
        "camera_skew", "low_coverage", "no_measurement",
    ),
    "motion": ("encoder_wrong", "encoder_silent", "encoder_motion", "thin_overlap", "belt_stopped", "empty"),
    "load": ("foreign_object", "oversize_lump", "overload", "misaligned_belt", "torn_edge_left", "torn_edge_right"),
    "geometry": (
        "camera_pose", "camera_pose_unchecked",
        "camera_redundancy", "projector_moved", "zero_shift", "zero_tilt", "zero_drift", "carry_back",
        "carry_back_stuck", "carry_back_total",
    ),
    "computer": (
        "disk_full", "history_repaired", "recording_paused", "users_unreadable",
        "reports_failing", "frames_dropped",
    ),
}  # fmt: skip
"""Alarms that one cause may raise together; in each group causes stand before their effects, which decides a tie."""


def find_group(name: str, groups: Mapping[str, Sequence[str]]) -> tuple[str, int]:
    """Return the group of an alarm and its place there; an empty name where no group has it."""
    for key in list_keys(name):
        for group, members in groups.items():
            if key in members:
                return group, members.index(key)
    return "", 0


@dataclass(frozen=True, slots=True)
class Member:
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

    _first: dict[str, Member] = field(default_factory=dict[str, Member])

    def update(self, present: Iterable[Member]) -> None:
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

    def restore(self, firsts: Iterable[Member]) -> None:
        """Continue with the first alarms of a run before."""
        self._first = {member.group: member for member in firsts}

    def has(self, name: str) -> bool:
        """Return whether an alarm came first in its group."""
        return any(member.name == name for member in self._first.values())


MAINTENANCE, BELT_STOPPED, CAMERAS_OFF = "maintenance", "belt_stopped", "cameras_off"
FRAMES_DROPPED = "frames_dropped"
"""The states of the plant that suppress alarms."""


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
