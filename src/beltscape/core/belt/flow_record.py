"""Flow records: volume, mass and speed of one strip of a moving belt per frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from beltscape.core.belt.sigma_parts import SigmaParts

Quality = Literal["measured", "degraded", "bridged", "missing"]
"""Quality of a strip:

measured   measured well at a known belt position
degraded   much of it was hidden, a camera was missing or contradicts the rig, or the belt's position was continued
           at its last known speed
bridged    part of it passed between frames and was interpolated between its neighbours
missing    not measured: it is not in the total, or it is counted with the next frame's strip
"""
_NO_PARTS = SigmaParts()
QUALITIES: tuple[Quality, ...] = ("measured", "degraded", "bridged", "missing")
"""All qualities, from good to bad."""


@dataclass(frozen=True, slots=True)
class FlowRecord:
    """The strip of belt that became new in one frame.

    Belt coordinate s: the belt position at which this piece of belt passes the origin of the belt frame. It grows
    against the travel, so a frame at position p sees the belt about s = p and its new strip ends upstream of it.
    """

    frame: str
    """Name of the frame."""
    time_ns: int | None
    """Trigger time, ns; None: not known."""
    belt_position_mm: float
    """Position by the encoder or, without one, by the material's motion from 0 at the first frame; NaN: not known."""
    strip_mm: tuple[float, float]
    """Beginning and end of the new strip, belt coordinate s; strips meet without gap or overlap."""
    area_mm2: float
    """Mean cross-section of the load on the strip; for a strip without length, the cross-section at its position.

    NaN for a strip that was not measured."""
    volume_mm3: float
    """Volume of the load on the strip, 0 if it was not measured; the records add up to the total."""
    sigma_mm3: float
    """One standard deviation of it."""
    speed_mm_s: float
    """Speed of the belt since the previous frame (for the first frame: until the next); NaN: not known."""
    density_kg_m3: float
    """Bulk density at that time; NaN: not known."""
    coverage: float
    """Share of the strip that was measured in any frame, 0..1; the rest is interpolated."""
    single_coverage: float
    """Mean share of the strip that a single frame measures, as a reference for the gain by fusing frames."""
    quality: Quality
    """Quality of the strip's measurement."""
    reason: str = ""
    """The faults that were found in its frames, in one line; empty without a fault."""
    common_sigma_mm3: float = math.nan
    """The part of ``sigma_mm3`` that other strips share; it does not average out. NaN: not known, up to all."""
    density_sigma_kg_m3: float = math.nan
    """One standard deviation of the density, common to all strips of a product; NaN: not known."""
    sigma_parts: SigmaParts = _NO_PARTS
    """What the strip adds to the parts of σ of a total; histories do not keep it."""

    def __repr__(self) -> str:
        length = (self.strip_mm[1] - self.strip_mm[0]) / 1000
        litres, sigma = self.volume_mm3 * 1e-6, self.sigma_mm3 * 1e-6
        return f"FlowRecord({self.frame}: {length:.3f} m, {litres:.3f} ± {sigma:.3f} l, {self.quality})"

    @property
    def volume_flow_m3_h(self) -> float:
        """Volume flow: cross-section times speed; NaN where the speed is not known."""
        return self.area_mm2 * self.speed_mm_s * 3600e-9

    @property
    def mass_flow_t_h(self) -> float:
        """Mass flow; NaN without a density."""
        return self.volume_flow_m3_h * self.density_kg_m3 * 1e-3
