"""What one may choose when measuring volume."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field


class VolumeSettings(BaseModel):
    """Settings of ``measure volume``; the defaults suit any rig."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    cell_mm: Annotated[float, Field(gt=0, le=100)] | None = None
    """Edge of a grid cell; None = 2.5 pixels on the belt, so that a typical cell holds six points."""
    profile_every_mm: Annotated[float, Field(gt=0, le=10_000)] = 50.0
    """Longest stretch of belt that one cross-section stands for."""
