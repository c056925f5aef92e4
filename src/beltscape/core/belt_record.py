"""The ledger of the belt: what is kept of every millimetre that passed, exactly once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beltscape.core.flow import FlowRecord, Quality

Standing = Literal["valid", "degraded", "missing"]
"""How a stretch of belt is counted:

valid      seen well by all cameras, and where the belt was is known
degraded   counted with less: hidden, bridged, placed by its last speed, or cameras were missing
missing    nothing tells what lay there; it is in no total
"""
STANDINGS: tuple[Standing, ...] = ("valid", "degraded", "missing")


def standing_from_quality(quality: Quality) -> Standing:
    """How a strip of that quality is counted."""
    return {"measured": "valid", "missing": "missing"}.get(quality, "degraded")  # pyright: ignore[reportReturnType]


@dataclass(frozen=True, slots=True, eq=False)
class CrossSection:
    """Mean load across the belt over a strip."""

    x_mm: NDArray[np.float32]
    """(Nx,) float32 ascending, in the belt frame."""
    height_mm: NDArray[np.float32]
    """(Nx,) float32 over the empty belt; NaN = not measured."""


@dataclass(frozen=True, slots=True, eq=False)
class BeltRecord:
    """One entry of the ledger.

    ``belt_mm`` is in the encoder's own count (where there is none, in that of the material's motion): the end of
    one entry is the beginning of the next, also across a stop, a crash or a change of the clock. A belt that
    passed while nothing ran is an entry of its own, with the standing "missing" and no strip.
    """

    number: int
    """Grows by one from entry to entry, for ever."""
    run: int
    """Which start of the program it is from."""
    belt_mm: tuple[float, float]
    """From where to where it reaches; the end is never before the beginning."""
    standing: Standing
    reason: str
    """Why it is not valid, in a few words; empty where it is."""
    wall_ns: int
    """System clock when it was finished, ns since 1970: for people, it may jump."""
    strip: FlowRecord | None
    """What was measured; None where nothing was."""
    run_sigma_mm3: float
    """One standard deviation of the volume of all its run up to it: strips' errors go together, σ do not just add."""
    cameras: int
    """Cameras that gave an image to its frame."""
    section: CrossSection | None
    """The mean cross-section behind it; None where nothing was measured."""
    offset_mm: float = 0.0
    """What the ledger's count is ahead of the encoder's: it changes only where an encoder began to count anew."""

    @property
    def length_mm(self) -> float:
        """Of the belt that it counts."""
        return self.belt_mm[1] - self.belt_mm[0]

    @property
    def volume_mm3(self) -> float:
        """Volume on it; 0 where nothing is counted."""
        return 0.0 if self.strip is None else self.strip.volume_mm3

    @property
    def sigma_mm3(self) -> float:
        """One standard deviation of it."""
        return 0.0 if self.strip is None else self.strip.sigma_mm3

    @property
    def mass_kg(self) -> float:
        """Mass on it; NaN where the density is not known."""
        return 0.0 if self.strip is None else self.strip.volume_mm3 * self.strip.density_kg_m3 * 1e-9


@dataclass(frozen=True, slots=True)
class Totals:
    """What the ledger adds up to."""

    records: int = 0
    volume_mm3: float = 0.0
    sigma_mm3: float = 0.0
    """One standard deviation; what errors have in common is taken to stay the same from run to run."""
    mass_kg: float = 0.0
    """NaN as soon as one strip's density is not known."""
    valid_mm: float = 0.0
    degraded_mm: float = 0.0
    missing_mm: float = 0.0
    since_ns: int | None = None
    """System clock at the first record; None while there is none."""

    @property
    def length_mm(self) -> float:
        """Of all belt that passed."""
        return self.valid_mm + self.degraded_mm + self.missing_mm
