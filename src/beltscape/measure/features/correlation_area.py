"""The correlation area of a depth map's errors on faces, from the autocorrelation of residuals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from beltscape.core.statistics import MAD_TO_SIGMA

_FARTHEST_PX = 24
"""Largest lag of the autocorrelation."""
_VANISHED = 0.05
"""An autocorrelation below this counts as noise."""


def estimate_correlation_area_px(
    residuals: Sequence[NDArray[np.floating]], farthest_px: int = _FARTHEST_PX
) -> float:
    """Return the number of pixels whose errors act as one: the summed autocorrelation of residuals (h, w).

    Residuals are NaN outside their face. The autocorrelation is pooled over all faces, clipped at three robust
    standard deviations, and summed up to the lag where it vanishes; the result is at least 1.
    """
    side = farthest_px
    total, pairs = np.zeros((2 * side + 1,) * 2), np.zeros((2 * side + 1,) * 2)
    for residual in residuals:
        products, count = _correlate_residuals(residual, side)
        total, pairs = total + products, pairs + count
    if pairs[side, side] == 0 or total[side, side] <= 0:
        return 1.0
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = np.where(pairs > 50, total / pairs, 0.0) / (total[side, side] / pairs[side, side])
    v, u = np.mgrid[-side : side + 1, -side : side + 1]
    lag = np.rint(np.hypot(u, v)).astype(np.intp)
    rings = np.bincount(lag.ravel(), correlation.ravel())[: side + 1] / np.bincount(lag.ravel())[: side + 1]
    vanished = np.nonzero(rings < _VANISHED)[0]
    reach = int(vanished[0]) if len(vanished) else side
    return float(max(correlation[lag < max(reach, 1)].sum(), 1.0))


def _correlate_residuals(
    residual: NDArray[np.floating], side: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the sums of products (2 side + 1, 2 side + 1) at each lag, and the number of pairs."""
    there = np.isfinite(residual)
    nothing = np.zeros((2 * side + 1,) * 2)
    if there.sum() < 30:
        return nothing, nothing
    rows, columns = (np.nonzero(there.any(axis=axis))[0] for axis in (1, 0))
    window = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    there, values = there[window], residual[window].astype(np.float64)
    middle = np.median(values[there])
    spread = MAD_TO_SIGMA * np.median(np.abs(values[there] - middle)) + 1e-12
    values = cast(
        "NDArray[np.float64]", np.where(there, np.clip((np.nan_to_num(values) - middle) / spread, -3, 3), 0)
    )
    shape = [int(fft.next_fast_len(n + 2 * side, real=True)) for n in there.shape]
    sums = [
        np.roll(fft.irfft2(_power_spectrum(field, shape), shape), (side, side), (0, 1))
        for field in (values, there.astype(np.float64))
    ]
    return sums[0][: 2 * side + 1, : 2 * side + 1], np.rint(sums[1][: 2 * side + 1, : 2 * side + 1])


def _power_spectrum(field: NDArray[np.float64], shape: list[int]) -> NDArray[np.float64]:
    return np.abs(fft.rfft2(field, shape)) ** 2
