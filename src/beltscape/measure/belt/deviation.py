"""Residuals about one constant cross-section: sag, waves and smooth errors of the rig, and how errors correlate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.belt.empty_belt import BeltDeviation
from beltscape.core.statistics import MAD_TO_SIGMA, compute_biweights

_NODES_ACROSS = 24
"""Nodes over the belt's width; the same spacing holds along the belt."""
_MIN_SIGNIFICANCE = 2.0
"""A deviation is significant where the nodes' mean square is at least this multiple of their mean σ²."""
_MIN_RMS_MM = 0.03
"""Least root mean square of the nodes: smaller ones come from folds that lie between two nodes of the section."""
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


def fit_deviation(
    points_mm: NDArray[np.float64], residual_mm: NDArray[np.float64], noise_mm: float, patch_px: float
) -> BeltDeviation | None:
    """Fit the deviation to points (H, W, 3) in the belt frame with heights over the cross-section (H, W).

    The errors of ``patch_px`` neighbouring pixels are taken as fully correlated. Nodes are robust means over
    their cells; the result is None where they scatter no more than such means do.
    """
    good = np.isfinite(residual_mm) & (np.abs(residual_mm) < 6 * noise_mm + 0.01 * np.nanstd(residual_mm))
    good |= np.isfinite(residual_mm) & (np.abs(residual_mm) < _inlier_limit_mm(residual_mm))
    if good.sum() < 1000:
        return None
    x, y, off = points_mm[..., 0][good], points_mm[..., 1][good], residual_mm[good]
    edges = [np.quantile(values, [0.001, 0.999]) for values in (x, y)]
    step = float(np.ptp(edges[0])) / _NODES_ACROSS
    nodes = [
        np.linspace(float(low), float(high), max(3, round((high - low) / step) + 1)) for low, high in edges
    ]
    column, row = (
        np.rint(np.interp(values, own, np.arange(len(own)))).astype(np.intp)
        for values, own in zip((x, y), nodes, strict=True)
    )
    shape = (len(nodes[1]), len(nodes[0]))
    cell = row * shape[1] + column
    count = np.bincount(cell, minlength=shape[0] * shape[1]).reshape(shape).astype(np.float64)
    weight = np.ones(len(off))
    mean, scale = np.zeros(shape), noise_mm
    for _ in range(3):  # Tukey weights about each node's mean
        total = np.bincount(cell, weight, shape[0] * shape[1]).reshape(shape)
        mean = np.bincount(cell, weight * off, shape[0] * shape[1]).reshape(shape) / np.maximum(total, 1e-9)
        left = off - mean.ravel()[cell]
        scale = MAD_TO_SIGMA * float(np.median(np.abs(left))) + 1e-9
        weight = compute_biweights(left, scale)
    full = count >= 0.1 * np.median(count[count > 0])
    sigma = scale * np.sqrt(np.minimum(patch_px / np.maximum(count, 1), 1.0))
    real = float(np.mean(mean[full] ** 2))
    if real < _MIN_SIGNIFICANCE * np.mean(sigma[full] ** 2) or real < _MIN_RMS_MM**2:
        return None
    nearest = ndimage.distance_transform_edt(~full, return_distances=False, return_indices=True)
    assert isinstance(nearest, np.ndarray)
    height = mean[tuple(nearest)]
    return BeltDeviation(
        nodes[0], nodes[1], height, np.where(full, sigma, np.hypot(scale, np.std(mean[full])))
    )


def _inlier_limit_mm(residual_mm: NDArray[np.float64]) -> float:
    """Return the limit of residuals that excludes gross errors and steps, but no sag."""
    measured = residual_mm[np.isfinite(residual_mm)]
    return (
        6 * MAD_TO_SIGMA * float(np.median(np.abs(measured - np.median(measured)))) if len(measured) else 0.0
    )
