"""Types of the matching: a camera's image, the images of an instant, the rules, a camera's statistics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

Payload = TypeVar("Payload")


@dataclass(frozen=True, slots=True)
class CameraImage(Generic[Payload]):
    """One image of one camera as received."""

    camera: str
    frame_id: int
    """The camera's count: 1 to 65535 and again from 1, or 64 bits; it begins anew when the camera is opened."""
    camera_ns: int
    """Camera's own clock at the exposure."""
    arrival_ns: int
    """Host's monotonic clock at its first packet."""
    payload: Payload


@dataclass(frozen=True, slots=True)
class MatchedInstant(Generic[Payload]):
    """The images of one instant."""

    time_ns: int
    """Host's monotonic clock at the instant; increasing."""
    shots: dict[str, CameraImage[Payload]]
    """By camera; cameras without an image are absent."""


@dataclass(frozen=True, slots=True)
class MatchingRules:
    """Rules by which images are matched."""

    window_ns: int
    """Images this near to the first of an instant may belong to it; less than half the time between instants."""
    skew_ns: int
    """Images farther from the median one are skipped."""
    timeout_ns: int
    """An instant waits this long for its last image."""
    clocks: Literal["own", "ptp"] = "own"
    """ptp: the cameras share one clock."""
    common_pulse: bool = False
    """Whether one pulse on a wire triggers all: a constant difference of two clocks is then their error, not skew."""
    start_ns: int = 0
    """Time for which the first camera waits for the others at the start."""


@dataclass(slots=True)
class CameraStatistics:
    """Statistics of one camera's images."""

    taken: int = 0
    """Complete images, without duplicates."""
    missed: int = 0
    """Instants that were completed without it."""
    late: int = 0
    """Images that arrived after their instant was completed."""
    duplicates: int = 0
    """Images that arrived again."""
    skipped: int = 0
    """Images that are missing by its count."""
    skewed: int = 0
    """Images skipped because they were too far from the others."""
    skew_ns: int | None = None
    """Time from the core's image to this camera's last one; negative if before it."""
    out_of_skew: int = 0
    """Number of its latest images in a row that were skipped for that."""
    unsynchronised: bool = False
    """Whether its clock differs from the shared one."""
    silent: bool = False
    """Whether an instant timed out waiting for it and no image has arrived since."""
    has_clock: bool = False
    """Whether its clock has been estimated since it was opened."""
