"""Settings of the paper's pairwise method."""

from __future__ import annotations

from pydantic import Field, model_validator

from beltscape.core.errors import SettingsError
from beltscape.stereo.checked_settings import CheckedSettings

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
