"""Settings of the multi-view matcher, and its two presets."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from beltscape.stereo.checked_settings import CheckedSettings, require_preset

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
        """Return the preset ``fast`` or ``standard``; docs/explanation/matching.md compares them."""
        return cls.model_validate(PRESETS[require_preset(name, PRESETS)])

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


PRESETS: dict[str, dict[str, object]] = {
    "fast": {
        "grid_step": 2,
        "plane_step_px": 1.25,
        "rounds": 1,
        "candidate_selection": False,
        "round_tolerances_px": (0.7,),
        "final_tolerance_px": 0.3,
        "twicing": False,
        "least_confidence": 0.4,
    },
    "standard": {},
}
