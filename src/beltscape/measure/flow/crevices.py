"""How far holes are filled too high, learned from places that most frames could not measure but some could.

A hole is interpolated from its rims; but what goes unmeasured between rocks is deep more often than not, by how
much depends on the material. Places that only few frames measured are of the same kind, and their height is known:
they are taken for holes once more, filled, and compared.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.measure.holes import Filled, fill_holes

_SELDOM = 0.5
"""Share of the frames in view that measured a place; up to that it is like a hole."""
_EDGES_MM = np.array([3.0, 8.0, 20.0])
"""Holes are told apart by the σ that their rims leave open."""
_FADE = 0.93
"""From block to block older comparisons fade."""
_PRIOR_MM = 200.0
"""Sum of σ over cells that speaks for no correction: it matters where little was compared."""
_MOST = 2.0
"""In units of σ: σ is that of a value anywhere between the lowest rim and the straight line, √12 σ apart."""


class Crevices:
    """Running comparison, by classes of σ; bounded in memory, the same for the same blocks."""

    def __init__(self) -> None:
        self._too_high_mm = np.zeros(len(_EDGES_MM) + 1)
        self._sigma_mm = np.zeros(len(_EDGES_MM) + 1)

    def learn(
        self,
        height_mm: NDArray[np.float64],
        sigma_mm: NDArray[np.float64],
        support: NDArray[np.float64],
        cell_mm: float,
        lean: NDArray[np.float64],
    ) -> None:
        """Compare a block (n, Nx): ``support`` is the share of frames in view that measured each cell."""
        test = np.isfinite(height_mm) & (support <= _SELDOM)
        self._too_high_mm *= _FADE
        self._sigma_mm *= _FADE
        known = np.isfinite(height_mm) & ~test
        if not test.any() or not known.any():
            return
        masked = np.where(test, np.nan, height_mm)
        filled = fill_holes(
            masked, np.where(test, np.nan, sigma_mm), np.zeros(test.shape, bool), cell_mm, lean
        )
        kind = np.digitize(filled.sigma_mm[test], _EDGES_MM)
        over = filled.value_mm[test] - height_mm[test]
        count = len(self._sigma_mm)
        self._too_high_mm += np.bincount(kind, over, count)
        self._sigma_mm += np.bincount(kind, filled.sigma_mm[test], count)

    @property
    def factors(self) -> NDArray[np.float64]:
        """(4,) by how many σ holes of each class are filled too high; never too low, for it is depth that hides."""
        return np.clip(self._too_high_mm / (self._sigma_mm + _PRIOR_MM), 0.0, _MOST)

    def lowered(self, filled: Filled) -> Filled:
        """The same with its holes at the height that the comparison expects."""
        kind = np.digitize(filled.sigma_mm, _EDGES_MM)
        value = np.where(filled.hole, filled.value_mm - self.factors[kind] * filled.sigma_mm, filled.value_mm)
        return Filled(value, filled.sigma_mm, filled.hole)
