"""Entries of the belt ledger, which counts every millimetre of belt that passed exactly once, and their totals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beltscape.core.belt.flow_record import FlowRecord, Quality

Standing = Literal["valid", "degraded", "missing"]
"""How a stretch of belt is counted:

valid      measured well by all cameras at a known belt position
degraded   measured with less: hidden, bridged, positioned by the last speed, or cameras were missing
missing    not measured; it is in no total
"""
STANDINGS: tuple[Standing, ...] = ("valid", "degraded", "missing")


def standing_from_quality(quality: Quality) -> Standing:
    """Return how a strip of this quality is counted."""
    return {"measured": "valid", "missing": "missing"}.get(quality, "degraded")  # pyright: ignore[reportReturnType]


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
