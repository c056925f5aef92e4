"""Settings of the management of alarms: [alarms.suppression], [alarms.shelving] and [alarms.groups]."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from beltscape.alarms.checks import CHECKS
from beltscape.alarms.management.suppression import BELT_STOPPED, CAMERAS_OFF, FRAMES_DROPPED, MAINTENANCE
from beltscape.alarms.names import KINDS, AlarmKey

_OF_THE_COMPUTER = (
    "disk_full",
    "history_repaired",
    "users_unreadable",
    "reports_failing",
    "recording_paused",
    "certificate_expiring",
)
"""Alarms that do not depend on what the cameras see."""
_OF_IMAGES = (
    "camera_lost", "camera_skew", "camera_sync", "low_coverage", "no_measurement", "frozen_image", "exposure",
    "overexposure", "lens_covered", "projector", "lamp", "dust", "flicker", "sunlight",
)  # fmt: skip
"""Alarms that cameras without images explain."""
_OF_DROPS = (
    "no_measurement", "low_coverage", "camera_skew", "camera_sync", "camera_pose_unchecked", "encoder_silent",
    "encoder_motion", "frozen_image", "flicker",
)  # fmt: skip
"""Alarms that a computer too slow for its frames explains: readings are late, neighbouring frames are missing."""


class SuppressionSettings(BaseModel):
    """The alarms that are suppressed by a state of the plant; they are evaluated and journalled, but not shown."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    maintenance: tuple[AlarmKey, ...] = tuple(n for n in (*KINDS, *CHECKS) if n not in _OF_THE_COMPUTER)
    """During maintenance: all that depend on what the cameras see."""
    belt_stopped: tuple[AlarmKey, ...] = ("empty", "misaligned_belt", "no_measurement", "low_coverage")
    """While the alarm belt_stopped is on: no new belt comes into view."""
    cameras_off: tuple[AlarmKey, ...] = _OF_IMAGES
    """While the alarm cameras_off is on for a bank; alarms of single cameras only for those of the bank."""

    frames_dropped: tuple[AlarmKey, ...] = _OF_DROPS
    """While the alarm frames_dropped is on: what comes of frames that are not measured."""

    def by_state(self) -> dict[str, tuple[str, ...]]:
        """Return the alarms of every state."""
        return {
            MAINTENANCE: self.maintenance,
            BELT_STOPPED: self.belt_stopped,
            CAMERAS_OFF: self.cameras_off,
            FRAMES_DROPPED: self.frames_dropped,
        }


class ShelvingSettings(BaseModel):
    """Shelving: an operator hides an alarm for a time."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    max_min: Annotated[float, Field(ge=1, le=10_080, allow_inf_nan=False)] = 480.0
    """Longest time in minutes: a shift, so that each shift decides anew."""
    never: tuple[AlarmKey, ...] = ()
    """Alarms that may not be shelved."""


def _check_groups(groups: Mapping[str, tuple[str, ...]]) -> Mapping[str, tuple[str, ...]]:
    """Return the groups; ValueError where an alarm is in two of them."""
    seen: dict[str, str] = {}
    for group, members in groups.items():
        for member in members:
            if member in seen:
                raise ValueError(f"{member!r} is in {seen[member]!r} and in {group!r}; give it one group")
            seen[member] = group
    return groups


Groups = Annotated[Mapping[str, tuple[AlarmKey, ...]], AfterValidator(_check_groups)]
"""Alarms with common causes by the name of their group, causes before effects."""
