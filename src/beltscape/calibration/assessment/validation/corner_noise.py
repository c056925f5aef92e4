"""Noise of detected corners, estimated from differences between neighbouring corners of one view.

A wrong lens, a moved camera or a bent board displaces neighbouring corners alike; noise does not. Second differences
of the residuals along rows and columns of the board cancel the former and keep the latter.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.assessment.validation.score import ViewResiduals
from beltscape.calibration.solver.robust import estimate_robust_sigma

Array = NDArray[np.float64]

MIN_DIFFERENCES = 40
"""Least number of differences for an estimate: its relative standard deviation is then below a fifth."""


def estimate_corner_noise_px(views: Iterable[ViewResiduals], triples: NDArray[np.int64]) -> float:
    """Return one standard deviation of a corner's coordinate, from its neighbours, px; NaN with too few of them.

    ``triples`` (T, 3) are ids of three corners in a row (`beltscape.target.board.list_triples`).
    """
    differences = np.concatenate(
        [np.empty((0, 2)), *(_compute_second_differences(view, triples) for view in views)]
    )
    return (
        estimate_robust_sigma(differences) / np.sqrt(6)
        if differences.size >= MIN_DIFFERENCES
        else float("nan")
    )


def _compute_second_differences(view: ViewResiduals, triples: NDArray[np.int64]) -> Array:
    """Return e₋₁ − 2 e₀ + e₊₁ (n, 2) of three corners in a row or column, px; six times the variance of one."""
    errors = np.full((max(int(triples.max(initial=0)), int(view.ids.max(initial=0))) + 1, 2), np.nan)
    errors[view.ids] = view.errors_px
    before, middle, after = errors[triples].transpose(1, 0, 2)
    differences = before - 2 * middle + after
    return differences[np.isfinite(differences).all(axis=1)]
