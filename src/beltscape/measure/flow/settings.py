"""What one may choose when measuring flow."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Direction = Literal["+y", "-y"]
Length = Annotated[float, Field(gt=0, le=100_000)]


class FlowSettings(BaseModel):
    """Settings of ``measure flow``; the defaults suit any rig and speed."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    direction: Direction | None = None
    """Which way the belt travels in the belt frame; None: found from the material."""
    cell_mm: Annotated[float, Field(gt=0, le=100)] | None = None
    """Edge of a cell of the fused surface; None: one pixel on the belt."""
    layers: Annotated[int, Field(ge=2, le=64)] = 12
    """Frames that are kept for one place of the belt; a slow belt's frames in between are left out."""
    block_mm: Length = 80.0
    """Length of belt whose holes are filled at once."""
    margin_mm: Length = 50.0
    """What is looked at beyond such a block; a stretch without any measured row that is longer is a gap."""
    bridge_mm: Length = 2000.0
    """Longest gap that is bridged; the volume on a longer one is not counted."""
    least_overlap: Annotated[float, Field(gt=0, lt=1)] = 0.12
    """Share of the view that two frames must have in common for their material to tell the belt's motion."""
