"""Settings of the flow measurement."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.quantities import CELL, STRETCH

Direction = Literal["+y", "-y"]
Length = Annotated[float, STRETCH]


class FlowSettings(BaseModel):
    """Settings of ``measure flow``; the defaults suit any rig and speed."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    direction: Direction | None = None
    """Direction of travel in the belt frame; None: determined from the material."""
    cell_mm: Annotated[float, CELL] | None = None
    """Edge of a cell of the fused surface; None: one pixel on the belt."""
    layers: Annotated[int, Field(ge=2, le=64)] = 12
    """Number of frames fused at one position of the belt; intermediate frames of a slow belt are skipped."""
    block_mm: Length = 80.0
    """Length of belt whose holes are filled at once. Each block also costs its margins: with 160 mm the filling takes
    two thirds of the time, with the same total, but a record waits for its block, and a failure loses more belt."""
    margin_mm: Length = 50.0
    """Length beyond a block that the filling uses; a longer stretch without any measured row is a gap."""
    bridge_mm: Length = 2000.0
    """Longest gap that is interpolated; the volume on a longer one is not counted."""
    least_overlap: Annotated[float, Field(gt=0, lt=1)] = 0.12
    """Share of the view that two frames must have in common for the registration of their material."""
    encoder_tolerance: Annotated[float, Field(gt=0, le=0.25)] = 0.005
    """Relative difference of encoder and material from which on the encoder is not trusted; half the tolerated error
    of the metres, so that either of the two is right within it."""
