"""What one cross-section all along the belt does not tell: sag between idlers, waves, a rig's slow errors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.belt_model import BeltDeviation

_NODES_ACROSS = 24
"""Nodes over the belt's width, square to as many along as it is long."""
_LEAST_REAL = 2.0
"""Mean square of the nodes over that of their σ from which on a deviation is more than noise."""

_LEAST_MM = 0.03
"""And their least root mean square: below, it is how a fold lies between two nodes."""


def find_deviation(
    points_mm: NDArray[np.float64], residual_mm: NDArray[np.float64], noise_mm: float, patch_px: float
) -> BeltDeviation | None:
    """Deviation from points (H, W, 3) in the belt frame and their heights over the cross-section (H, W).

    ``patch_px`` neighbouring pixels err as one. Nodes are robust means over their surroundings; None where they
    scatter no more than such means do.
    """
    good = np.isfinite(residual_mm) & (np.abs(residual_mm) < 6 * noise_mm + 0.01 * np.nanstd(residual_mm))
    good |= np.isfinite(residual_mm) & (np.abs(residual_mm) < _wide(residual_mm))
    if good.sum() < 1000:
        return None
    x, y, off = points_mm[..., 0][good], points_mm[..., 1][good], residual_mm[good]
    edges = [np.quantile(values, [0.001, 0.999]) for values in (x, y)]
    step = float(np.ptp(edges[0])) / _NODES_ACROSS
    nodes = [np.linspace(low, high, max(3, round((high - low) / step) + 1)) for low, high in edges]
    column, row = (
        np.rint(np.interp(values, own, np.arange(len(own)))).astype(np.intp)
        for values, own in zip((x, y), nodes, strict=True)
    )
    shape = (len(nodes[1]), len(nodes[0]))
    cell = row * shape[1] + column
    count = np.bincount(cell, minlength=shape[0] * shape[1]).reshape(shape).astype(np.float64)
    weight = np.ones(len(off))
    mean, scale = np.zeros(shape), noise_mm
    for _ in range(3):  # Tukey's weights about each node's own mean
        total = np.bincount(cell, weight, shape[0] * shape[1]).reshape(shape)
        mean = np.bincount(cell, weight * off, shape[0] * shape[1]).reshape(shape) / np.maximum(total, 1e-9)
        left = off - mean.ravel()[cell]
        scale = 1.4826 * float(np.median(np.abs(left))) + 1e-9
        weight = np.clip(1 - (left / (4.685 * scale)) ** 2, 0, None) ** 2
    full = count >= 0.1 * np.median(count[count > 0])
    sigma = scale * np.sqrt(np.minimum(patch_px / np.maximum(count, 1), 1.0))
    real = float(np.mean(mean[full] ** 2))
    if real < _LEAST_REAL * np.mean(sigma[full] ** 2) or real < _LEAST_MM**2:
        return None
    nearest = ndimage.distance_transform_edt(~full, return_distances=False, return_indices=True)
    assert isinstance(nearest, np.ndarray)
    height = mean[tuple(nearest)]
    return BeltDeviation(
        nodes[0], nodes[1], height, np.where(full, sigma, np.hypot(scale, np.std(mean[full])))
    )


def _wide(residual_mm: NDArray[np.float64]) -> float:
    """Reach that leaves out gross errors and steps, but no sag."""
    known = residual_mm[np.isfinite(residual_mm)]
    return 6 * 1.4826 * float(np.median(np.abs(known - np.median(known)))) if len(known) else 0.0
