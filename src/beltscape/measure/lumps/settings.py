"""Settings of the lump measurement."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, field_validator

from beltscape.core.quantities import LUMP, SIEVE

Sieve = Annotated[float, SIEVE]
R10_MM = (8.0, 10.0, 12.5, 16.0, 20.0, 25.0, 31.5, 40.0, 50.0, 63.0, 80.0, 100.0, 125.0)
"""Apertures of the R10 series (ISO 565)."""


class LumpSettings(BaseModel):
    """Settings of ``measure lumps``; the defaults suit any rig."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    oversize_mm: Annotated[float, LUMP] | None = None
    """A lump larger than this raises the alarm; None = no alarm."""
    sieves_mm: tuple[Sieve, ...] = R10_MM
    """Apertures of the sieve table, ascending."""
    smallest_px: Annotated[float, Field(ge=4, le=200)] = 8.0
    """A region narrower than this, in pixels of the working raster, counts as fines."""
    raster_pixels: Annotated[int, Field(ge=10_000, le=20_000_000)] = 400_000
    """Approximate number of pixels to which the depth map is reduced by a whole factor."""
    split: Annotated[float, Field(gt=0, lt=1)] = 0.15
    """Neighbouring regions are merged where the mean probability of an outline between them is below this."""

    @field_validator("sieves_mm")
    @classmethod
    def _ascending(cls, sieves: tuple[float, ...]) -> tuple[float, ...]:
        if not sieves or any(a >= b for a, b in pairwise(sieves)):
            raise ValueError("sieves must ascend, as 10,20,40")
        return sieves
