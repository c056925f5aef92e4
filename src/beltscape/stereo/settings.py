"""Settings of the matchers: the multi-view matcher with its presets, and the paper's pairwise method.

An invalid value that a Python caller gives raises a SettingsError of one line.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self, get_args

from pydantic import BaseModel, ConfigDict, Field, ModelWrapValidatorHandler, ValidationError, model_validator

from beltscape.core.checks import show_value
from beltscape.core.errors import SettingsError, suggest_name
from beltscape.files.toml_text import describe_first_error


class CheckedSettings(BaseModel):
    """Immutable settings without unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @model_validator(mode="wrap")
    @classmethod
    def _validate(cls, values: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Validate, or raise a SettingsError that names the setting, its value and the allowed ones."""
        try:
            return handler(values)
        except ValidationError as error:
            raise SettingsError(f"{cls.__name__}: {describe_first_error(cls, error)}") from error

    def revalidate(self) -> Self:
        """Return the same settings, validated anew: ``model_copy(update=…)`` does not validate."""
        return type(self).model_validate(dict(self.__dict__))


Preset = Literal["fast", "standard"]
"""Names of the multi-view matcher's presets."""


def require_preset(name: Any) -> Preset:
    """Return the name of a preset; raise a SettingsError that lists the presets for any other."""
    names: tuple[Preset, ...] = get_args(Preset)
    found = next((one for one in names if isinstance(name, str) and one == name), None)
    if found is None:
        fix = suggest_name(str(name), names) or f"there are {', '.join(names)}"
        raise SettingsError(f"preset = {show_value(name)} is not known; {fix}")
    return found


Distance = Annotated[float, Field(ge=1, le=100)]
Tolerance = Annotated[float, Field(ge=0.01, le=100)]

_LEAST_WIDTH_PX = 480
"""Least width of a grid; on narrower ones the pattern's dots would vanish."""


class MultiviewSettings(CheckedSettings):
    """Settings of sweep, propagation and least squares; the defaults are the preset ``standard``."""

    grid_step: int = Field(
        default=1, ge=1, le=4, description="side of a grid pixel in image pixels, for large images"
    )
    sweep_width_px: int = Field(
        default=612, ge=64, le=4096, description="approximate width of the sweep's images"
    )
    distances_px: tuple[Distance, ...] = Field(
        default=(3.0, 10.0),
        min_length=1,
        max_length=8,
        description="distances from which candidates come, in eight directions",
    )
    plane_step_px: float = Field(
        default=1.0, gt=0, le=2, description="distance of the sweep's planes, px of its images"
    )
    rounds: int = Field(
        default=2,
        ge=1,
        le=8,
        description="largest number of rounds of propagation and least squares on each grid",
    )
    candidate_selection: bool = Field(
        default=True, description="let uncertain pixels near reliable ones select among candidate surfaces"
    )
    round_tolerances_px: tuple[Tolerance, ...] = Field(
        default=(1.0,),
        min_length=1,
        max_length=8,
        description="tolerances of the iterations after each round",
    )
    final_tolerance_px: Tolerance = Field(default=0.25, description="tolerance of the last iteration")
    twicing: bool = Field(default=True, description="correct the flattening by the last fit's windows")
    least_confidence: float = Field(
        default=0.75, ge=0, lt=1, description="confidence below which a pixel is not measured"
    )
    threads: int = Field(default=0, ge=0, le=256, description="number of threads; 0: one per processor core")

    @classmethod
    def preset(cls, name: str) -> MultiviewSettings:
        """Return a preset's settings; docs/explanation/matching.md compares them."""
        return cls.model_validate(PRESETS[require_preset(name)])

    def offsets_px(self, scale: float) -> tuple[int, ...]:
        """Return the distinct `distances_px` on a grid of this scale."""
        return tuple(sorted({max(1, round(distance * scale)) for distance in self.distances_px}))

    def step(self, width_px: int) -> int:
        """Return `grid_step` for images of this width; it is reduced for small images."""
        return max(1, min(self.grid_step, width_px // _LEAST_WIDTH_PX))

    def has_coarser_grid(self, grid_px: int) -> bool:
        """Return whether a grid of this width starts from one of half the width."""
        return grid_px // 2 >= _LEAST_WIDTH_PX

    def grids(self, width_px: int) -> int:
        """Return the number of grids on which images of this width are matched."""
        grid_px, count = width_px // self.step(width_px), 1
        while self.has_coarser_grid(grid_px):
            grid_px, count = grid_px // 2, count + 1
        return count

    def shrink(self, grid_px: int) -> int:
        """Return the factor by which the sweep's images are smaller than a grid of this width."""
        return max(1, round(grid_px / self.sweep_width_px))


PRESETS: dict[Preset, dict[str, object]] = {
    "fast": {
        "grid_step": 2,
        "plane_step_px": 1.25,
        "rounds": 1,
        "candidate_selection": False,
        "round_tolerances_px": (0.7,),
        "final_tolerance_px": 0.3,
        "twicing": False,
        "least_confidence": 0.5,
    },
    "standard": {},
}

_TARGET_WIDTH_PX = 1536
"""Width up to which narrower images are enlarged before matching."""
_MAX_OVERSAMPLING = 1.5
"""Largest factor of this enlargement."""


class PairwiseSettings(CheckedSettings):
    """Semi-global matching of each rectified pair, and the mean over the pairs."""

    block_px: int = Field(default=3, ge=1, le=9, description="edge of the matching block, odd")
    step_penalty: float = Field(
        default=5, ge=0, le=200, description="SGBM's P1 per pixel of the block: a step of 1 px"
    )
    jump_penalty: float = Field(
        default=40, ge=1, le=200, description="SGBM's P2 per pixel of the block: a larger step"
    )
    gradient_cap: int = Field(
        default=127, ge=15, le=127, description="SGBM's clip of the horizontal gradient, counts"
    )
    uniqueness_percent: int = Field(
        default=10, ge=0, le=50, description="least margin of the best match over the second best"
    )
    left_right_px: int = Field(default=1, ge=1, le=16, description="allowed left-right difference")
    speckle_area_px: int = Field(
        default=100, ge=0, le=10_000, description="smaller regions of consistent disparity are removed"
    )
    speckle_step_px: int = Field(
        default=2, ge=1, le=16, description="largest step of disparity within such a region"
    )
    contrast_radius_px: float = Field(
        default=16, ge=1, le=64, description="sigma of the neighbourhood whose contrast is equalised"
    )
    oversampling: float | None = Field(
        default=None,
        ge=0.5,
        le=3,
        description="rectified over original sampling; null: finer for small images",
    )
    agreement_px: float | None = Field(
        default=4.0,
        gt=0,
        le=64,
        description="rectified px; pairs that differ by more are not averaged; null: Eq. 24 unchanged",
    )
    threads: int = Field(
        default=0, ge=0, le=256, description="pairs matched at a time; 0: the number of cores"
    )

    def choose_oversampling(self, width_px: int) -> float:
        """Return the oversampling for images of this width; dots of 1–2 px are matched better on a finer grid."""
        if self.oversampling is not None:
            return self.oversampling
        return min(max(_TARGET_WIDTH_PX / width_px, 1.0), _MAX_OVERSAMPLING)

    @model_validator(mode="after")
    def _check_consistency(self) -> PairwiseSettings:
        if self.block_px % 2 == 0:
            raise SettingsError(f"PairwiseSettings: block_px = {self.block_px}: must be odd")
        if self.jump_penalty <= self.step_penalty:
            raise SettingsError(
                f"PairwiseSettings: jump_penalty = {self.jump_penalty:g}: must be larger than step_penalty = "
                f"{self.step_penalty:g}"
            )
        return self
