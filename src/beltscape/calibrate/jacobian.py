"""Projection and its derivatives, for many observations at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def project(points: Array, intrinsics: Array) -> tuple[Array, Array, Array]:
    """Points in camera frames → pixels and their derivatives.

    Parameters
    ----------
    points
        (N, 3) in the frame of the camera that sees each, mm.
    intrinsics
        (N, 9) fx, fy, cx, cy, k1, k2, p1, p2, k3 of that camera.

    Returns
    -------
    (N, 2) pixels, (N, 2, 3) their derivatives by the point, (N, 2, 9) by the intrinsics.
    """
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = intrinsics.T
    inverse = 1.0 / points[:, 2]
    x, y = points[:, 0] * inverse, points[:, 1] * inverse
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (
        k1 + r2 * (2 * k2 + 3 * r2 * k3)
    )  # d radial / d r2, twice: times x or y gives d radial / d x, y
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    pixels = np.stack([fx * xd + cx, fy * yd + cy], axis=-1)

    xx = radial + x * x * slope + 2 * p1 * y + 6 * p2 * x
    xy = x * y * slope + 2 * p1 * x + 2 * p2 * y
    yy = radial + y * y * slope + 6 * p1 * y + 2 * p2 * x
    by_point = np.empty((len(points), 2, 3))
    by_point[:, 0, 0], by_point[:, 0, 1] = fx * xx * inverse, fx * xy * inverse
    by_point[:, 1, 0], by_point[:, 1, 1] = fy * xy * inverse, fy * yy * inverse
    by_point[:, :, 2] = -(by_point[:, :, 0] * x[:, None] + by_point[:, :, 1] * y[:, None])

    by_intrinsics = np.zeros((len(points), 2, 9))
    by_intrinsics[:, 0, 0], by_intrinsics[:, 1, 1] = xd, yd
    by_intrinsics[:, 0, 2] = by_intrinsics[:, 1, 3] = 1.0
    for column, (u, v) in {
        4: (x * r2, y * r2),
        5: (x * r2**2, y * r2**2),
        6: (2 * x * y, r2 + 2 * y * y),
        7: (r2 + 2 * x * x, 2 * x * y),
        8: (x * r2**3, y * r2**3),
    }.items():
        by_intrinsics[:, 0, column], by_intrinsics[:, 1, column] = fx * u, fy * v
    return pixels, by_point, by_intrinsics


def by_pose(by_point: Array, rotated: Array) -> Array:
    """(N, 2, 6) derivatives by a small turn (radians, about the frame it turns into) and shift (mm).

    ``by_point`` (N, 2, 3) is by the transformed point, ``rotated`` (N, 3) the point after rotation, before the shift:
    d(exp(ω) R p + t) = ω × R p + dt.
    """
    turn = np.cross(rotated[:, None, :], by_point)  # (J · (ω × q)) = ω · (q × J)
    return np.concatenate([turn, by_point], axis=-1)
