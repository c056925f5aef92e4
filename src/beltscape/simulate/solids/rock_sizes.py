"""Size distributions of broken rock by mass, and sizes drawn from them."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

Millimetres = Annotated[float, Field(gt=0, le=1e4, allow_inf_nan=False)]
_STEPS = 4000
"""Steps of the integration over the sizes."""


class SizeSettings(BaseModel):
    """The share of the mass that passes a sieve of width d, truncated at both ends.

    Rosin–Rammler: 1 − exp(−ln 2·(d/median)ⁿ); Gaudin–Schuhmann: (d/largest)ⁿ.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    law: Literal["rosin-rammler", "gaudin-schuhmann"] = "rosin-rammler"
    smallest_mm: Millimetres = 10.0
    largest_mm: Millimetres = 79.0
    median_mm: Millimetres = 50.0
    """Median by mass of the untruncated Rosin–Rammler law."""
    exponent: Annotated[float, Field(gt=0, le=20)] = 2.5
    """Uniformity of the distribution: a larger exponent makes it narrower."""

    @model_validator(mode="after")
    def _check_order(self) -> SizeSettings:
        if self.smallest_mm >= self.largest_mm:
            raise ValueError(
                f"smallest_mm = {self.smallest_mm:g} must be below largest_mm = {self.largest_mm:g}"
            )
        return self

    def share_passing(self, size_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the mass share of rocks up to sizes (N,); 0 at the smallest size, 1 at the largest."""
        ends = self._untruncated(np.array([self.smallest_mm, self.largest_mm]))
        inside = np.clip(size_mm, self.smallest_mm, self.largest_mm)
        return (self._untruncated(inside) - ends[0]) / (ends[1] - ends[0])

    def _untruncated(self, size_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        if self.law == "gaudin-schuhmann":
            return (size_mm / self.largest_mm) ** self.exponent
        return 1 - np.exp(-np.log(2) * (size_mm / self.median_mm) ** self.exponent)


def draw_sizes(settings: SizeSettings, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return (count,) sizes in mm whose mass (∝ d³) follows the law, in random order.

    One size is drawn from each of ``count`` equal shares of the number distribution, so that few rocks follow it too.
    """
    edges = np.geomspace(settings.smallest_mm, settings.largest_mm, _STEPS + 1)
    middles = np.sqrt(edges[1:] * edges[:-1])
    number = np.cumsum(np.diff(settings.share_passing(edges)) / middles**3)  # number of rocks: mass over d³
    share = np.concatenate([[0.0], number / number[-1]])
    quantiles = (np.arange(count) + rng.random(count)) / max(count, 1)
    return rng.permutation(np.interp(quantiles, share, edges))
