"""What one may choose when measuring volume."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field


class VolumeSettings(BaseModel):
    """Settings of ``measure volume``; the defaults suit any rig."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    cell_mm: Annotated[float, Field(gt=0, le=100)] | None = None
    """Edge of a cell of the height map given back; None = three pixels on the belt: nine points in a typical
    cell. It is rounded to whole pixels. The volume itself is summed over cells of one pixel."""
    profile_every_mm: Annotated[float, Field(gt=0, le=10_000)] = 50.0
    """Longest stretch of belt that one cross-section stands for."""
