"""Points from rays: the reference of `triangulate`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.geometry.triangulation import TriangulationInput

MAX_CONDITION = 1e12
"""A point is refused when ‖N‖·‖N⁻¹‖ (Frobenius) of its normal matrix exceeds this, because then four digits of a
double are left."""


def triangulate(given: TriangulationInput) -> tuple[NDArray[np.float64]]:
    """Return the points (N, 3)."""
    projections, pixels = given
    points = [_triangulate_point(projections, p) for p in np.swapaxes(pixels, 0, 1)]
    return (np.array(points).reshape(-1, 3),)


def _triangulate_point(projections: NDArray[np.float64], pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return one point (3,) from projections (n, 3, 4) and pixels (n, 2): Eq. 3 solved by least squares."""
    seen = np.isfinite(pixels).all(axis=1)
    if seen.sum() < 2:
        return np.full(3, np.nan)
    m, (u, v) = projections[seen], pixels[seen].T
    rows_u = u[:, None] * m[:, 2, :] - m[:, 0, :]
    rows_v = v[:, None] * m[:, 2, :] - m[:, 1, :]
    equations = np.concatenate([rows_u, rows_v])
    a, b = equations[:, :3], -equations[:, 3]
    singular = np.linalg.svd(a, compute_uv=False)
    squared = singular**2
    with np.errstate(divide="ignore"):
        condition = np.linalg.norm(squared) * np.linalg.norm(1 / squared)
    if not condition < MAX_CONDITION:
        return np.full(3, np.nan)
    return np.linalg.lstsq(a, b, rcond=None)[0]
