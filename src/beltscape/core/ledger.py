"""Flow records, one strip of a moving belt per frame, and the entries and totals of the belt ledger.

The ledger counts every millimetre of belt that passed exactly once. The parts of a volume's uncertainty add up over
strips.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class SigmaParts:
    """The parts of σ of a volume; those of a longer stretch of belt are the sums of those of its strips.

    Common errors add linearly, independent ones in squares (GUM, JCGM 100:2008, 5.2.2).
    """

    apart_mm6: float = 0.0
    """Variance of errors that are independent from strip to strip."""
    edges_mm3: float = 0.0
    """σ of the common displacement of all edges."""
    holes_mm3: float = 0.0
    """σ of the common error of all filled holes."""
    drift_mm3: float = 0.0
    """σ of slow errors of depth, common to the whole belt."""
    faults_mm3: float = 0.0
    """σ of the faults that were found, common to all strips."""
    scale_mm3: float = 0.0
    """σ by the size of the calibration board, to which all lengths of the rig are in proportion."""

    def __add__(self, other: SigmaParts) -> SigmaParts:
        return SigmaParts(
            self.apart_mm6 + other.apart_mm6,
            self.edges_mm3 + other.edges_mm3,
            self.holes_mm3 + other.holes_mm3,
            self.drift_mm3 + other.drift_mm3,
            self.faults_mm3 + other.faults_mm3,
            self.scale_mm3 + other.scale_mm3,
        )

    @property
    def common_sigma_mm3(self) -> float:
        """Return the part of σ that is the same error in all strips: all but what is independent."""
        common = self.edges_mm3, self.holes_mm3, self.drift_mm3, self.faults_mm3, self.scale_mm3
        return math.hypot(*common)

    @property
    def sigma_mm3(self) -> float:
        """Return one standard deviation of the volume."""
        return math.sqrt(self.apart_mm6 + self.common_sigma_mm3**2)


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
    """What the strip adds to the parts of σ of a total; all 0: not known, as in histories of older programs."""

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


Standing = Literal["valid", "degraded", "missing"]
"""How a stretch of belt is counted:

valid      measured well by all cameras at a known belt position
degraded   measured with less: hidden, bridged, positioned by the last speed, or cameras were missing
missing    not measured; it is in no total
"""
STANDINGS: tuple[Standing, ...] = ("valid", "degraded", "missing")


def standing_from_quality(quality: Quality) -> Standing:
    """Return how a strip of this quality is counted."""
    standings: dict[Quality, Standing] = {"measured": "valid", "missing": "missing"}
    return standings.get(quality, "degraded")


@dataclass(frozen=True, slots=True, eq=False)
class CrossSection:
    """Mean load across the belt over a strip."""

    x_mm: NDArray[np.float32]
    """(Nx,) float32 ascending, in the belt frame."""
    height_mm: NDArray[np.float32]
    """(Nx,) float32 over the empty belt; NaN = not measured."""


@dataclass(frozen=True, slots=True)
class RecordTag:
    """The present product with its bulk density, and the present batch, for which records are counted."""

    product: str = ""
    """Name of the product; empty: none is defined, and the density is that of the measurement."""
    density_kg_m3: float = math.nan
    """Bulk density of the product."""
    density_sigma_kg_m3: float = math.nan
    """One standard deviation of it."""
    batch: int = 0
    """Number of the batch; 0: none."""


@dataclass(frozen=True, slots=True, eq=False)
class BeltRecord:
    """One entry of the ledger.

    ``belt_mm`` is the encoder's own count (without an encoder, that of the material's motion): the end of one entry
    is the beginning of the next, also across a stop, a crash or a change of the clock. Belt that passed while
    nothing ran is an entry of its own, with the standing "missing" and no strip.
    """

    number: int
    """Grows by one from entry to entry, without end."""
    run: int
    """Number of the program start that wrote it."""
    belt_mm: tuple[float, float]
    """Beginning and end of the stretch; the end is never before the beginning."""
    standing: Standing
    reason: str
    """Why it is not valid, in a few words; empty where it is."""
    wall_ns: int
    """System clock when it was finished, ns since 1970; for display only, as it may jump."""
    strip: FlowRecord | None
    """The measurement; None where there is none."""
    run_sigma_mm3: float
    """One standard deviation of its run's volume up to it; strips' errors are correlated, so their σ do not add."""
    cameras: int
    """Number of cameras with an image in its frame."""
    section: CrossSection | None
    """The mean cross-section that was measured; None where there is none."""
    offset_mm: float = 0.0
    """The ledger's count minus the encoder's; it changes only where an encoder restarted its count."""
    product: str = ""
    """Name of the product on it; empty: none is defined."""
    batch: int = 0
    """Number of the batch that it is counted for; 0: none."""

    @property
    def length_mm(self) -> float:
        """Length of the stretch."""
        return self.belt_mm[1] - self.belt_mm[0]

    @property
    def volume_mm3(self) -> float:
        """Volume on it; 0 where nothing is counted."""
        return 0.0 if self.strip is None or self.standing == "missing" else self.strip.volume_mm3

    @property
    def sigma_mm3(self) -> float:
        """One standard deviation of it."""
        return 0.0 if self.strip is None else self.strip.sigma_mm3

    @property
    def mass_kg(self) -> float:
        """Mass on it; NaN where the density is not known."""
        if self.strip is None or self.standing == "missing":
            return 0.0
        return self.strip.volume_mm3 * self.strip.density_kg_m3 * 1e-9


@dataclass(frozen=True, slots=True)
class Totals:
    """Totals of the ledger."""

    records: int = 0
    volume_mm3: float = 0.0
    sigma_mm3: float = 0.0
    """One standard deviation; the common part of the errors is taken to be the same in all runs."""
    mass_kg: float = 0.0
    """NaN as soon as one strip's density is not known."""
    valid_mm: float = 0.0
    degraded_mm: float = 0.0
    missing_mm: float = 0.0
    since_ns: int | None = None
    """System clock at the first record; None while there is none."""

    @property
    def length_mm(self) -> float:
        """Length of all belt that passed."""
        return self.valid_mm + self.degraded_mm + self.missing_mm
