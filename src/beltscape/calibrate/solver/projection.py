"""Projection of points through the lens model, with its Jacobians, for many observations at once.

Returned arrays have the observations last in memory, whatever their shape: sums over them are faster that way.
`Camera.project` evaluates the same model for one camera in another order of operations; a test compares the two.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = intrinsics.T
    inverse = 1.0 / points[:, 2]
    x, y = points[:, 0] * inverse, points[:, 1] * inverse
    xx, xy, yy = x * x, x * y, y * y
    r2 = xx + yy
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    # 2 · d radial / d r2; times x or y it is d radial / d x or d y
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))
    by_p1, by_p2 = (2 * xy, r2 + 2 * yy), (r2 + 2 * xx, 2 * xy)
    xd = x * radial + p1 * by_p1[0] + p2 * by_p2[0]
    yd = y * radial + p1 * by_p1[1] + p2 * by_p2[1]
    pixels = np.stack([fx * xd + cx, fy * yd + cy])

    mixed = slope * xy + 2 * (p1 * x + p2 * y)
    by_point = np.empty((3, 2, len(points)))
    by_point[0, 0] = fx * inverse * (radial + slope * xx + 2 * p1 * y + 6 * p2 * x)
    by_point[1, 1] = fy * inverse * (radial + slope * yy + 6 * p1 * y + 2 * p2 * x)
    by_point[1, 0], by_point[0, 1] = fx * inverse * mixed, fy * inverse * mixed
    by_point[2] = -(by_point[0] * x + by_point[1] * y)

    by_intrinsics = np.zeros((9, 2, len(points)))
    by_intrinsics[0, 0], by_intrinsics[1, 1] = xd, yd
    by_intrinsics[2, 0] = by_intrinsics[3, 1] = 1.0
    along_x, along_y = fx * x * r2, fy * y * r2
    for column in (4, 5, 8):  # k1, k2, k3
        by_intrinsics[column, 0], by_intrinsics[column, 1] = along_x, along_y
        along_x, along_y = along_x * r2, along_y * r2
    for column, (u, v) in {6: by_p1, 7: by_p2}.items():
        by_intrinsics[column, 0], by_intrinsics[column, 1] = fx * u, fy * v
    return pixels.T, by_point.T, by_intrinsics.T


def project_points(points: Array, intrinsics: Array) -> Array:
    """Return the pixels (N, 2) of `project_with_jacobians` without derivatives."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = intrinsics.T
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    r2, xy = x * x + y * y, 2 * x * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = x * radial + p1 * xy + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + p2 * xy
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
