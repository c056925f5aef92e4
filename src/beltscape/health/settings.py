"""Settings of the system's checks of itself: the table [health] of project.toml, with the limits of [health.belt]."""

from __future__ import annotations

from typing import Annotated, Literal

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


_Share = Annotated[float, Field(gt=0, lt=1)]


class HealthSettings(BaseModel):
    """Limits of the checks of images; the defaults are above what sound captures of seven rigs showed."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    images: bool = True
    """Whether the images are checked before they are matched."""
    projector: Literal["auto", "yes", "no"] = "auto"
    """Whether a projector lights the belt; "auto": recognised from the contrast of the first sound frames."""
    belt: BeltLimits = BeltLimits()
    """Limits of the checks of heights: the table [health.belt]."""
    learning: bool = True
    """Whether reference values are learned; without them a camera is compared with the others of its frame only."""
    learning_frames: Annotated[int, Field(ge=3, le=10_000)] = 20
    """Number of sound frames from which the reference values of the cameras are learned."""
    saturated: _Share = 0.02
    """Share of saturated pixels; sound captures have up to 0.0005."""
    brightness_factor: Annotated[float, Field(gt=1, le=100)] = 1.8
    """Brightness over, or under, that of the other cameras; sound captures differ by up to 1.3."""
    dark_level: Annotated[float, Field(gt=0, le=128)] = 4.0
    """Brightness of an image, of 255, below which rounding to whole levels hides texture; sound: from 9."""
    contrast_loss: _Share = 0.35
    """Loss of contrast against the other cameras, before reference values are known; sound: up to 0.1."""
    contrast_change: _Share = 0.25
    """Loss of contrast against the other cameras and the camera's own reference; sound: up to 0.08."""
    pattern_loss: _Share = 0.3
    """Loss of the projected pattern's contrast in all cameras against the reference; sound: up to 0.03."""
    flicker: _Share = 0.15
    """Sudden change of the brightness of the whole picture in all cameras."""
    sunlight: _Share = 0.02
    """Share of the picture that is bright and without the projected pattern; sound: up to 0.003."""
    dirt: _Share = 0.12
    """Loss of light at fixed pixels against the other cameras, averaged over frames; sound: up to 0.06."""
    dirt_area: _Share = 0.005
    """Share of the picture from which dirt is reported."""
    projector_mm: Annotated[float, Field(gt=0, le=1000)] = 1.0
    """Displacement of the projected pattern on the bare belt; sound: up to 0.1."""
    skew_ms: Annotated[float, Field(gt=0, le=1000)] = 0.1
    """Difference of a camera's instant from the others', by the images; it must also exceed 3 σ."""
