"""What the paper's pairwise method can be told."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field, model_validator


class PairwiseSettings(BaseModel):
    """Semi-global matching of each rectified pair, and the mean over the pairs."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    block_px: int = Field(3, ge=1, le=9, description="edge of the matching block, odd")
    step_penalty: float = Field(
        6, ge=0, le=200, description="SGBM's P1 per pixel of the block: a step of 1 px"
    )
    jump_penalty: float = Field(
        36, ge=1, le=200, description="SGBM's P2 per pixel of the block: a larger step"
    )
    gradient_cap: int = Field(
        127, ge=15, le=127, description="SGBM's clip of the horizontal gradient, counts"
    )
    uniqueness_percent: int = Field(10, ge=0, le=50, description="margin by which the best match must win")
    left_right_px: int = Field(1, ge=1, le=16, description="allowed left-right difference")
    speckle_area_px: int = Field(100, ge=0, le=10_000, description="smaller islands of disparity are removed")
    speckle_step_px: int = Field(2, ge=1, le=16, description="an island ends where disparity steps by more")
    contrast_radius_px: float = Field(
        8, ge=1, le=64, description="sigma of the neighbourhood whose contrast is made equal"
    )
    agreement_px: float | None = Field(
        1.5,
        gt=0,
        le=64,
        description="pairs farther apart than this are not averaged; null: Eq. 24 as it stands",
    )
    threads: int = Field(
        0, ge=0, le=256, description="pairs matched at a time; 0: as many as there are cores"
    )

    @model_validator(mode="after")
    def _fits(self) -> PairwiseSettings:
        if self.block_px % 2 == 0:
            raise ValueError(f"block_px is {self.block_px}; it must be odd")
        if self.jump_penalty <= self.step_penalty:
            raise ValueError("jump_penalty must be larger than step_penalty")
        return self
