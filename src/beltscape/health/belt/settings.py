"""Limits of the checks of heights: the table [health.belt] of project.toml."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.quantities import BELT_LENGTH, CARRY_BACK, ZERO_SHIFT

_Millimetres = Annotated[float, ZERO_SHIFT]


class BeltLimits(BaseModel):
    """Limits of the empty belt's zero and of what is stuck to the belt."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    enabled: bool = True
    """Whether the bare belt in view is compared with the learned one."""
    zero_mm: _Millimetres = 0.3
    """Mean rise or fall of the bare belt from which records are degraded; below it, it only enters their σ.

    On sound simulated captures of five rigs it repeats to 0.01 mm; the thickness of new belts varies by ±0.2 mm."""
    zero_sigmas: Annotated[float, Field(ge=2, le=20)] = 4.0
    """Multiple of its σ that a shift must exceed, too."""
    tilt_mm: _Millimetres = 1.5
    """Rise of an edge or end of the view by a tilt or a lateral shift, from which records are degraded."""
    search_mm: _Millimetres = 40.0
    """Largest shift that is searched; a smooth surface further from the learned belt counts as material."""
    set_limit_mm: _Millimetres = 2.0
    """Largest shift that setting the zero accepts."""
    belt_length_m: Annotated[float, BELT_LENGTH] | None = None
    """Length of the endless belt: what returns with it is stuck to the belt or part of it."""
    empty_m: Annotated[float, Field(gt=0, le=1000)] = 3.0
    """Length without a load after which material on the belt is carry-back; gaps of a thin load are shorter."""
    carry_back_mm2: Annotated[float, CARRY_BACK] = 300.0
    """Mean cross-section of material on otherwise empty belt from which carry-back is reported."""
