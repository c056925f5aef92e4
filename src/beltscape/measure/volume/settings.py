"""Settings of the volume measurement."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.quantities import CELL, PROFILE

Surcharge = Annotated[float, Field(ge=0, le=45)]
"""Surcharge angle in degrees, at which the load of a full moving belt rises from its sides; some 15° below the angle
of repose."""
SURCHARGE_DEG = 20.0
"""A common value for bulk material on a running belt (DIN 22101)."""


class VolumeSettings(BaseModel):
    """Settings of ``measure volume``; the defaults suit any rig."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    cell_mm: Annotated[float, CELL] | None = None
    """Edge of a cell of the resulting height map, rounded to whole pixels; None = three pixels on the belt. The
    volume itself is summed over cells of one pixel."""
    profile_every_mm: Annotated[float, PROFILE] = 50.0
    """Longest stretch of belt that one cross-section averages over."""
    surcharge_deg: Surcharge = SURCHARGE_DEG
    """Surcharge angle of the full belt that the fill level refers to."""
