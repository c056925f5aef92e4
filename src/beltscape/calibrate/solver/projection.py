"""Projection of points through the lens model, with its Jacobians, for many observations at once.

Returned arrays have the observations last in memory, whatever their shape: sums over them are faster that way.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry import lens

Array = NDArray[np.float64]


def project_with_jacobians(points: Array, intrinsics: Array) -> tuple[Array, Array, Array]:
    """Project points in camera frames to pixels, with derivatives.

    Parameters
    ----------
    points
        (N, 3) each in the frame of the camera that sees it, mm.
    intrinsics
        (N, 9) fx, fy, cx, cy, k1, k2, p1, p2, k3 of that camera; (9,) if one camera sees all.

    Returns
    -------
    (N, 2) pixels, (N, 2, 3) their derivatives by the point, (N, 2, 9) by the intrinsics.
    """
    fx, fy, cx, cy, *_ = intrinsics.T
    coefficients = intrinsics.T[4:]
    inverse = 1.0 / points[:, 2]
    x, y = points[:, 0] * inverse, points[:, 1] * inverse
    xd, yd = lens.distort(x, y, coefficients)
    pixels = np.stack([fx * xd + cx, fy * yd + cy])

    xx, xy, yy = lens.differentiate(x, y, coefficients)
    by_point = np.empty((3, 2, len(points)))
    by_point[0, 0] = fx * inverse * xx
    by_point[1, 1] = fy * inverse * yy
    by_point[1, 0], by_point[0, 1] = fx * inverse * xy, fy * inverse * xy
    by_point[2] = -(by_point[0] * x + by_point[1] * y)

    by_intrinsics = np.zeros((9, 2, len(points)))
    by_intrinsics[0, 0], by_intrinsics[1, 1] = xd, yd
    by_intrinsics[2, 0] = by_intrinsics[3, 1] = 1.0
    by_intrinsics[4:] = lens.differentiate_by_coefficients(x, y, fx, fy)
    return pixels.T, by_point.T, by_intrinsics.T


def project_points(points: Array, intrinsics: Array) -> Array:
    """Return the pixels (N, 2) of `project_with_jacobians` without derivatives."""
    fx, fy, cx, cy, *_ = intrinsics.T
    u, v = lens.distort(points[:, 0] / points[:, 2], points[:, 1] / points[:, 2], intrinsics.T[4:])
    return np.stack([fx * u + cx, fy * v + cy]).T


def rotate_vectors(rotations: Array, vectors: Array) -> Array:
    """Return vectors (N, 3), each rotated by its own rotation (N, 3, 3)."""
    x, y, z = vectors.T
    r = rotations.T  # r[j, i]: row i, column j
    return (r[0] * x + r[1] * y + r[2] * z).T


def differentiate_by_pose(by_point: Array, rotated: Array) -> Array:
    """Return derivatives (N, 2, 6) by a small rotation (rad, in the target frame's axes) and translation (mm).

    ``by_point`` (N, 2, 3) are derivatives by the transformed point; ``rotated`` (N, 3) is the rotated point
    before translation:
    d(exp(ω) R p + t) = ω × R p + dt.
    """
    (a, b, c), (x, y, z) = by_point.T, rotated.T
    # (J · (ω × q)) = ω · (q × J)
    return np.stack([y * c - z * b, z * a - x * c, x * b - y * a, a, b, c]).T
