"""The live state at one instant, without pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import nan

from beltscape.core.belt.ledger_entries import Totals
from beltscape.core.live.alarms import Alarm
from beltscape.core.live.events import CameraHealth, Maintenance
from beltscape.core.live.findings import Finding
from beltscape.service.view_models.flow import CurrentFlow


@dataclass(frozen=True, slots=True)
class FlowPoint:
    """The flow at one instant, for the chart."""

    wall_ms: int
    """System clock, ms since 1970."""
    flow: CurrentFlow
    """The flow at that instant."""


@dataclass(frozen=True, slots=True)
class FrameStatistics:
    """Counts and timing of frame sets."""

    done: int = 0
    """Measured since the start."""
    dropped: int = 0
    """Skipped since the start."""
    waiting: int = 0
    """Number of frame sets in the queue."""
    seconds: float = nan
    """Time that the last one took."""
    coverage: float = nan
    """Share of the last one that was measured."""
    speed_mm_s: float = nan
    """Speed of the belt at the last one; NaN: not known."""
    largest_lump_mm: float = nan
    """Sieve size of the largest lump at the last search; NaN: none was made."""
    full_area_mm2: float = nan
    """Cross-section of the fully loaded belt; NaN: not known."""


@dataclass(frozen=True, slots=True)
class CheckState:
    """The newest finding of one check."""

    finding: Finding
    wall_ns: int
    """System clock when it was made."""
    age_s: float
    """Seconds since then."""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The whole live state without pictures, at one instant."""

    wall_ns: int
    """System clock."""
    frames: FrameStatistics
    """Counts and timing of frame sets."""
    flow: CurrentFlow
    """Volume and mass flow."""
    totals: Totals
    """The ledger's sums."""
    cameras: tuple[CameraHealth, ...]
    """Cameras in the order of their names."""
    alarms: tuple[Alarm, ...]
    """All alarms in their current state."""
    notes: tuple[tuple[int, str], ...]
    """The last messages: system clock in ms, text."""
    frame_age_s: float
    """Seconds since the last frame set was processed; inf: none yet."""
    health_age_s: float
    """Seconds since the cameras' health was last reported; inf: never."""
    record: int | None
    """Number of the newest record; None while there is none."""
    picture_frames: Mapping[str, str]
    """Frame name of the newest picture of every camera that has sent one."""
    maintenance: Maintenance | None
    """The present maintenance; None: there is none."""
    stale_s: float
    """Age from which a frame or a record is not current: the setting, or more for frames in longer intervals."""
