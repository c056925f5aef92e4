"""Fringe patterns of a structured-light projector: sinusoids, each shifted in equal steps.

Phase shifting: N pictures 1/2 + 1/2·cos(φ − 2πk/N), k = 0 … N − 1, of each number of fringes; several numbers of
fringes resolve the order of the fringe (Zuo et al., Optics and Lasers in Engineering 109, 2018, 23-59,
doi:10.1016/j.optlaseng.2018.04.019, and 85, 2016, 84-103, doi:10.1016/j.optlaseng.2016.04.022).
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator


class FringeSettings(BaseModel):
    """A sequence of fringe patterns across the projector's columns."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    fringes: Annotated[
        tuple[Annotated[float, Field(ge=0.5, le=2000)], ...], Field(min_length=1, max_length=8)
    ] = (
        1.0,
        8.0,
        64.0,
    )
    """Numbers of fringes over the projector's width, coarse first; the first, 1 or less, is unambiguous."""
    steps: Annotated[int, Field(ge=3, le=64)] = 4
    """Phase shifts per number of fringes."""

    @model_validator(mode="after")
    def _check_order(self) -> FringeSettings:
        if list(self.fringes) != sorted(set(self.fringes)) or self.fringes[0] > 1:
            raise ValueError(f"fringes = {list(self.fringes)}: ascending, and the first not above 1")
        return self

    @property
    def frames(self) -> int:
        """Return the number of pictures of the whole sequence."""
        return len(self.fringes) * self.steps

    def periods_px(self, width_px: int) -> tuple[float, ...]:
        """Return the period of the fringes on a projector of this width, by number of fringes."""
        return tuple(width_px / count for count in self.fringes)


def make_fringe_patterns(settings: FringeSettings, size_px: tuple[int, int]) -> NDArray[np.float32]:
    """Return (F, H, W) linear light 0..1 of a projector (W, H): all shifts of one fringe number, then the next."""
    width, height = size_px
    columns = np.arange(width)
    rows = [
        0.5 + 0.5 * np.cos(2 * np.pi * (columns / period - k / settings.steps))
        for period in settings.periods_px(width)
        for k in range(settings.steps)
    ]
    return np.repeat(np.array(rows, np.float32)[:, None], height, axis=1)
