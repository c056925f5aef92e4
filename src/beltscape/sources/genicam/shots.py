"""The vocabulary of matching: a camera's image, the images of an instant, the rules, what was seen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

Payload = TypeVar("Payload")


@dataclass(frozen=True, slots=True)
class CameraImage(Generic[Payload]):
    """One camera's image, as it came."""

    camera: str
    frame_id: int
    """The camera's count: 1 to 65535 and again from 1, or 64 bits; begins anew when the camera is opened."""
    camera_ns: int
    """The camera's own clock when it was taken."""
    arrival_ns: int
    """Host's monotonic clock when its first packet came."""
    payload: Payload


@dataclass(frozen=True, slots=True)
class MatchedInstant(Generic[Payload]):
    """The images of one instant."""

    time_ns: int
    """Host's monotonic clock at the instant; grows from one to the next."""
    shots: dict[str, CameraImage[Payload]]
    """By camera; those without an image are absent."""


@dataclass(frozen=True, slots=True)
class MatchingRules:
    """How images are matched."""

    window_ns: int
    """Images this near to the first of an instant may be of it; less than half the time between instants."""
    skew_ns: int
    """Images farther from the middle one are left out."""
    timeout_ns: int
    """An instant waits this long for its last image."""
    clocks: Literal["own", "ptp"] = "own"
    """ptp: the cameras share one clock."""
    common_pulse: bool = False
    """One pulse on a wire triggers all: what stays between two clocks is their error, not skew."""
    start_ns: int = 0
    """So long the first camera waits for the others at the start."""


@dataclass(slots=True)
class CameraStatistics:
    """What was seen of one camera."""

    taken: int = 0
    """Images that came whole, duplicates not counted."""
    missed: int = 0
    """Instants that were given out without it."""
    late: int = 0
    """Images that came after their instant was given out."""
    duplicates: int = 0
    """Images that came again."""
    skipped: int = 0
    """Images that its count says were lost on the way."""
    skewed: int = 0
    """Images left out because they were too far from the others."""
    skew_ns: int | None = None
    """How far its last image was from the core's; before the core's: negative."""
    out_of_skew: int = 0
    """Images in a row that were left out for that."""
    unsynchronised: bool = False
    """Whether its clock is not the one the others share."""
    silent: bool = False
    """Whether an instant waited for it in vain and nothing has come since."""
    has_clock: bool = False
    """Whether its clock is known since it was opened."""
