"""The spatial correlation of a depth map's errors, from its residuals on a smooth surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

_BLOCK_PX = 64
"""Side of the larger blocks; the smaller ones have half of it."""


@dataclass(frozen=True, slots=True)
class ErrorCorrelation:
    """Errors of a depth map as patches of fully correlated pixels plus a slow part that does not average out."""

    area_px: float
    """Pixels whose errors act as one (the integral of the autocorrelation); 1 for independent pixels."""
    drift_mm: float
    """Standard deviation of the slow part."""


def estimate_correlation(residual_mm: NDArray[np.float64], noise_mm: float) -> ErrorCorrelation:
    """Estimate the correlation of residuals (H, W) mm, NaN where there are none, of robust scatter ``noise_mm``.

    The variance of means over blocks of 32 and 64 pixels is compared: the part due to patches falls with the
    block's area, the slow part does not. The slow part counts only where it is significant.
    """
    if noise_mm <= 0:
        return ErrorCorrelation(1.0, 0.0)
    clipped = np.clip(residual_mm, -3 * noise_mm, 3 * noise_mm)
    small, _ = _block_mean_square(clipped, _BLOCK_PX // 2)
    large, blocks = _block_mean_square(clipped, _BLOCK_PX)
    if not blocks:
        return ErrorCorrelation(100.0, 0.0)
    slow = (large - small / 4) * 4 / 3
    slow = max(0.0, slow - 2 * large * np.sqrt(2.0 / blocks))
    square = float(np.nanmean(clipped**2))
    side = _BLOCK_PX // 2
    apparent = np.sqrt(max(small - slow, 0.0) / max(square, 1e-30)) * side
    # the block's border cuts off a window's triangular autocorrelation: c · (1 - c / 3 side) remains; and the
    # fitted cross-section absorbs the error that a block shares with its column
    apparent /= np.sqrt(1 - side / max(residual_mm.shape[0], 2 * side))
    area = (1.5 * side * (1 - np.sqrt(max(0.0, 1 - 4 * apparent / (3 * side))))) ** 2
    return ErrorCorrelation(float(np.clip(area, 1.0, side**2)), float(np.sqrt(slow)))


def _block_mean_square(residual: NDArray[np.float64], side: int) -> tuple[float, int]:
    """Return the mean square of the block means, and the number of blocks that are mostly measured."""
    height, width = (n // side * side for n in residual.shape)
    blocks = residual[:height, :width].reshape(height // side, side, width // side, side)
    count = np.isfinite(blocks).sum(axis=(1, 3))
    full = count >= 0.7 * side * side
    if not full.any():
        return 0.0, 0
    means = cast("NDArray[np.float64]", np.nansum(blocks, axis=(1, 3))[full] / count[full])
    return float(np.mean(means**2)), int(full.sum())
