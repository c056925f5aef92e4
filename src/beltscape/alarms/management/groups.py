"""First-out: which alarm of a group with common causes came first."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from beltscape.alarms.names import list_keys

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
