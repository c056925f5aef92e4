"""The running system's events and states: cameras, frames, stretches of belt, maintenance, a proposed zero."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import FrameSet

CameraState = Literal["ok", "waiting", "lost", "unusable"]
"""ok; no image yet; no image for too long; images unusable (overexposed, dark, another size)"""


@dataclass(frozen=True, slots=True)
class CertificateReading:
    """The newest certificate of the material test, at one moment."""

    number: str
    days_left: float
    """Until it ends; negative afterwards."""
    changed: tuple[str, ...] = ()
    """What it applies to and has changed since: "rig", "empty", "settings", "networks", "program"."""

    @property
    def in_force(self) -> str:
        """Return its number; empty where it has ended or does not apply any more."""
        return self.number if self.days_left >= 0 and not self.changed else ""


@dataclass(frozen=True, slots=True)
class CameraHealth:
    """The state of one camera."""

    name: str
    state: CameraState
    frames: int
    """Images taken since the start."""
    missed: int
    """Trigger instants since the start without an image from it."""
    rate_hz: float
    """Images per second over the last seconds; 0 without images."""
    skew_ms: float
    """Time from the core's last image to this camera's, by the cameras' own clocks; NaN: not known."""
    message: str = ""
    """The fault and the fix in one line; empty without a fault."""


@dataclass(frozen=True, slots=True, eq=False)
class BeltStretch:
    """A finished stretch of the fused belt, for display."""

    start_mm: float
    """Belt coordinate of its first row."""
    cell_mm: float
    """Distance of rows."""
    x_mm: NDArray[np.float32]
    """(Nx,) float32 across the belt."""
    height_mm: NDArray[np.float32]
    """(n, Nx) float32 load over the empty belt, holes filled."""
    measured: NDArray[np.bool_]
    """(n, Nx) where a frame measured it."""


@dataclass(frozen=True, slots=True)
class Capacity:
    """What the computer can measure; NaN: not known yet."""

    sets_per_s: float
    """Frame sets in a second."""
    speed_mm_s: float
    """Speed of the belt up to which every millimetre is in two of them."""


NO_CAPACITY = Capacity(math.nan, math.nan)
"""The capacity before enough frame sets were measured."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameEvent:
    """A frame set that has been processed, with the state of the queue."""

    frames: FrameSet
    done: int
    """Frame sets measured since the start."""
    dropped: int
    """Frame sets skipped since the start because newer ones were waiting."""
    waiting: int
    """Frame sets in the queue."""
    seconds: float
    """Time from the last image's arrival to the end of its measurement."""
    coverage: float
    """Share of the core's pixels that were measured; 0 where the frame gave none."""
    speed_mm_s: float
    """Speed of the belt; NaN: not known."""
    largest_lump_mm: float = math.nan
    """Sieve size of the largest lump at the last search; 0: there was none; NaN: none was made."""
    full_area_mm2: float = math.nan
    """Cross-section of the fully loaded belt; NaN: not known."""
    capacity: Capacity = NO_CAPACITY
    """What the computer can measure with the present settings."""
    view_mm: float = math.nan
    """Length of belt that a frame set sees; NaN: not known."""
    repeated: int = 0
    """Frame sets since the start that were not matched, as they showed the belt of the last matched one."""
    is_repeat: bool = False
    """Whether this is one of them: what was measured in the last one holds for it."""


@dataclass(frozen=True, slots=True)
class Maintenance:
    """A period in which people work at the system: belt that passes is missing, alarms of measurement are held."""

    reason: str
    """Such as "cleaning"."""
    by: str
    """Name of the user that began it."""
    since_ns: int
    """System clock when it began."""
    until_ns: int
    """System clock when it ends by itself."""


@dataclass(frozen=True, slots=True)
class ZeroProposal:
    """The measured motion of the empty belt since it was learned, which setting the zero accounts for."""

    number: int
    """Names it when it is confirmed."""
    offset_mm: float
    """Mean rise of the belt."""
    sigma_mm: float
    """One standard deviation of it."""
    tilt_mm: float
    """Largest rise of an edge or end of the view by tilt or lateral shift."""
    frames: int
    """Number of frames that were measured."""
    limit_mm: float
    """Largest rise or tilt that is accepted."""
