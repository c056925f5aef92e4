"""How far the errors of neighbouring pixels go together, from what is left over on a smooth surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_SIDE = 64


@dataclass(frozen=True, slots=True)
class Correlation:
    """Errors of a depth map as patches that go together, over a slow part that no patch averages out."""

    area_px: float
    """Pixels whose errors act as one (the integral of the autocorrelation); 1 for independent pixels."""
    drift_mm: float
    """Scatter of the slow part."""


def correlation(residual_mm: NDArray[np.float64], noise_mm: float) -> Correlation:
    """Correlation of residuals (H, W) mm, NaN where there are none, whose robust scatter is ``noise_mm``.

    Means over blocks of 32 and 64 pixels: patches of correlated errors make their variance fall with the
    block's area; what does not fall is the slow part, counted where it is more than chance makes it.
    """
    if noise_mm <= 0:
        return Correlation(1.0, 0.0)
    clipped = np.clip(residual_mm, -3 * noise_mm, 3 * noise_mm)
    small, _ = _mean_square(clipped, _SIDE // 2)
    large, blocks = _mean_square(clipped, _SIDE)
    if not blocks:
        return Correlation(100.0, 0.0)
    slow = (large - small / 4) * 4 / 3
    slow = max(0.0, slow - 2 * large * np.sqrt(2.0 / blocks))
    square = float(np.nanmean(clipped**2))
    side = _SIDE // 2
    apparent = np.sqrt(max(small - slow, 0.0) / max(square, 1e-30)) * side
    # a window's triangular autocorrelation is cut off by the block's border: c · (1 - c / 3 side) shows; and
    # the fitted cross-section takes with it what a block shares with its column
    apparent /= np.sqrt(1 - side / max(residual_mm.shape[0], 2 * side))
    area = (1.5 * side * (1 - np.sqrt(max(0.0, 1 - 4 * apparent / (3 * side))))) ** 2
    return Correlation(float(np.clip(area, 1.0, side**2)), float(np.sqrt(slow)))


def _mean_square(residual: NDArray[np.float64], side: int) -> tuple[float, int]:
    """Mean square of the block means, and the number of blocks that are mostly measured."""
    height, width = (n // side * side for n in residual.shape)
    blocks = residual[:height, :width].reshape(height // side, side, width // side, side)
    count = np.isfinite(blocks).sum(axis=(1, 3))
    full = count >= 0.7 * side * side
    if not full.any():
        return 0.0, 0
    means = np.nansum(blocks, axis=(1, 3))[full] / count[full]
    return float(np.mean(means**2)), int(full.sum())
