"""What passed on a moving belt: one record per frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Quality = Literal["measured", "degraded", "bridged", "missing"]
"""How far to believe a strip:

measured   seen well, and where the belt was is known
degraded   much of it was hidden, a camera was missing or contradicts the rig, or the belt's position was continued
           at its last known speed
bridged    part of it passed between frames, and was interpolated between its neighbours
missing    nothing tells what lay there: it is not in the total, or it is counted with the next frame's strip
"""
QUALITIES: tuple[Quality, ...] = ("measured", "degraded", "bridged", "missing")
"""From good to bad."""


@dataclass(frozen=True, slots=True)
class FlowRecord:
    """The strip of belt that became new in one frame.

    Belt coordinate s: the belt position at which this piece of belt passes the origin of the belt frame. It grows
    against the travel, so a frame at position p sees the belt about s = p and its new strip ends upstream of it.
    """

    frame: str
    """Name of the frame."""
    time_ns: int | None
    """Trigger time, ns; None where nobody told it."""
    belt_position_mm: float
    """The encoder's where there is one, else from the material, from 0 at the first frame; NaN: not known."""
    strip_mm: tuple[float, float]
    """From where to where the new strip reaches, belt coordinate s; strips meet without gap or overlap."""
    area_mm2: float
    """Mean cross-section of the load on the strip; of a strip without length: at its place."""
    volume_mm3: float
    """Volume of the load on the strip; the records add up to the total."""
    sigma_mm3: float
    """One standard deviation of it."""
    speed_mm_s: float
    """Of the belt since the frame before (of the first frame: up to the next); NaN: not known."""
    density_kg_m3: float
    """Bulk density at that time; NaN: nobody told it."""
    coverage: float
    """Share of the strip that was measured in any frame, 0..1; the rest is interpolated."""
    single_coverage: float
    """Share of it that one frame measures, on average: what the fusion of frames adds shows against it."""
    quality: Quality
    """How far to believe it."""

    @property
    def volume_flow_m3_h(self) -> float:
        """Volume flow: cross-section times speed; NaN where the speed is not known."""
        return self.area_mm2 * self.speed_mm_s * 3600e-9

    @property
    def mass_flow_t_h(self) -> float:
        """Mass flow; NaN without a density."""
        return self.volume_flow_m3_h * self.density_kg_m3 * 1e-3
