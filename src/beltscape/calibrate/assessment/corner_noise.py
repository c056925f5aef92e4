"""Noise of the corners themselves: what neighbouring corners of one view disagree by.

A wrong lens, a moved camera or a bent board displaces neighbouring corners alike; noise does not. Second differences
of the residuals along rows and columns of the board cancel the former and keep the latter.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from beltscape.calibrate.assessment.score import ViewResiduals

Array = NDArray[np.float64]

MAD_TO_SIGMA = 1.4826
"""Standard deviation over median absolute value, of a normal distribution."""
MIN_DIFFERENCES = 40
"""Differences from which on their scale is stated: its standard deviation is then below a fifth."""


def estimate_corner_noise_px(views: Iterable[ViewResiduals], grid: tuple[int, int]) -> float:
    """Return one standard deviation of a corner's coordinate by its neighbours, px; NaN with too few neighbours."""
    differences = np.concatenate(
        [np.empty((0, 2)), *(_compute_second_differences(view, grid) for view in views)]
    )
    return (
        estimate_robust_sigma(differences) / np.sqrt(6)
        if differences.size >= MIN_DIFFERENCES
        else float("nan")
    )


def estimate_robust_sigma(values: Array) -> float:
    """Return the standard deviation of values about zero by their median size; NaN without any."""
    return float(MAD_TO_SIGMA * np.median(np.abs(values))) if values.size else float("nan")


def _compute_second_differences(view: ViewResiduals, grid: tuple[int, int]) -> Array:
    """(n, 2) e₋₁ − 2 e₀ + e₊₁ of three corners in a row or a column, px; six times the variance of one."""
    columns, rows = grid
    errors = np.full((rows * columns, 2), np.nan)
    errors[view.ids] = view.errors_px
    errors = errors.reshape(rows, columns, 2)
    across = errors[:, :-2] - 2 * errors[:, 1:-1] + errors[:, 2:]
    down = errors[:-2] - 2 * errors[1:-1] + errors[2:]
    found = np.concatenate([across.reshape(-1, 2), down.reshape(-1, 2)])
    return found[np.isfinite(found).all(axis=1)]
