"""What the multi-view matcher can be told, and its three presets."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from beltscape.stereo.checked_settings import CheckedSettings, require_preset

Distance = Annotated[float, Field(ge=1, le=100)]
Tolerance = Annotated[float, Field(ge=0.01, le=100)]

_LEAST_WIDTH_PX = 480
"""A grid is not made narrower than that: the pattern's dots would vanish."""


class MultiviewSettings(CheckedSettings):
    """Sweep, propagation and joint least squares; the defaults are the preset ``standard``."""

    grid_step: int = Field(
        1, ge=1, le=4, description="image pixels per side of a pixel that is matched, where images are large"
    )
    sweep_width_px: int = Field(
        612, ge=64, le=4096, description="the sweep's images are shrunk to about this width"
    )
    distances_px: tuple[Distance, ...] = Field(
        (3.0, 10.0),
        min_length=1,
        max_length=8,
        description="from where candidates come, in eight directions",
    )
    plane_step_px: float = Field(1.0, gt=0, le=2, description="between the sweep's planes, px of its images")
    rounds: int = Field(
        2, ge=1, le=8, description="most rounds of propagation on each grid, coarse to fine, each refined"
    )
    contests: int = Field(
        1, ge=0, le=4, description="how often doubtful pixels near trusted ones are looked at again"
    )
    between_px: tuple[Tolerance, ...] = Field(
        (1.0,), min_length=1, max_length=8, description="tolerances of the iterations after each round"
    )
    final_px: tuple[Tolerance, ...] = Field(
        (0.4, 0.25), min_length=1, max_length=8, description="tolerances of the last iterations"
    )
    sharpen: bool = Field(True, description="put back what the last fit's windows have flattened")
    least_confidence: float = Field(0.75, ge=0, lt=1, description="less trusted pixels are not measured")
    threads: int = Field(0, ge=0, le=256, description="0: as many as there are cores")

    @classmethod
    def preset(cls, name: str) -> MultiviewSettings:
        """``fast``, ``standard`` or ``fine``; docs/matching.md states what each costs and reaches."""
        return cls.model_validate(PRESETS[require_preset(name, PRESETS)])

    def offsets_px(self, scale: float) -> tuple[int, ...]:
        """`distances_px` on a grid so many times finer, each once."""
        return tuple(sorted({max(1, round(distance * scale)) for distance in self.distances_px}))

    def step(self, width_px: int) -> int:
        """`grid_step` for images of this width: small images are not made coarser still."""
        return max(1, min(self.grid_step, width_px // _LEAST_WIDTH_PX))

    def halves(self, grid_px: int) -> bool:
        """Whether a grid so wide begins with what one half as wide found."""
        return grid_px // 2 >= _LEAST_WIDTH_PX

    def grids(self, width_px: int) -> int:
        """On how many grids images of this width are matched."""
        grid_px, count = width_px // self.step(width_px), 1
        while self.halves(grid_px):
            grid_px, count = grid_px // 2, count + 1
        return count

    def shrink(self, grid_px: int) -> int:
        """How much smaller than a grid of this width the sweep's images are."""
        return max(1, round(grid_px / self.sweep_width_px))


PRESETS: dict[str, dict[str, object]] = {
    "fast": {
        "grid_step": 2,
        "plane_step_px": 1.25,
        "rounds": 1,
        "contests": 0,
        "between_px": (0.7,),
        "final_px": (0.3,),
        "sharpen": False,
        "least_confidence": 0.4,
    },
    "standard": {},
    "fine": {
        "plane_step_px": 0.5,
        "distances_px": (2.0, 5.0, 12.0),
        "rounds": 4,
        "contests": 2,
        "final_px": (0.6, 0.4, 0.3, 0.2),
    },
}
