"""What one may choose when measuring volume."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Surcharge = Annotated[float, Field(ge=0, le=45)]
"""Angle in degrees at which the load of a full belt rises from its sides; of a moving belt, some 15° below the angle
of repose."""
SURCHARGE_DEG = 20.0


class VolumeSettings(BaseModel):
    """Settings of ``measure volume``; the defaults suit any rig."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    cell_mm: Annotated[float, Field(gt=0, le=100)] | None = None
    """Edge of a cell of the height map given back; None = three pixels on the belt: nine points in a typical
    cell. It is rounded to whole pixels. The volume itself is summed over cells of one pixel."""
    profile_every_mm: Annotated[float, Field(ge=0.1, le=10_000)] = 50.0
    """Longest stretch of belt that one cross-section stands for."""
    surcharge_deg: Surcharge = SURCHARGE_DEG
    """Of a full belt, against which the fill level is measured."""
