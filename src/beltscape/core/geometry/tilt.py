"""The homography of a tilted sensor (Scheimpflug), as OpenCV's 14-coefficient model applies it after all other terms.

With the rotation R = R_y(τy) R_x(τx) of the sensor, q = R (x, y, 1):

    x' = R₃₃ q₁/q₃ − R₁₃,    y' = R₃₃ q₂/q₃ − R₂₃,

which keeps the principal point at 0.

References
----------
OpenCV documentation, module calib3d, "Camera Calibration and 3D Reconstruction"; C. Louhichi et al., Self-calibration
of Scheimpflug cameras, Measurement Science and Technology 18(8), 2007, doi:10.1088/0957-0233/18/8/012.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Array

Angle: TypeAlias = NDArray[np.float64] | float
"""Radians, of all points or of each."""


def compute_homography(tau_x: float, tau_y: float) -> Array:
    """Return the homography (3, 3) of a sensor tilted by ``tau_x`` and ``tau_y``, rad."""
    (sx, cx), (sy, cy) = (np.sin(tau_x), np.cos(tau_x)), (np.sin(tau_y), np.cos(tau_y))
    rotation = np.array([[cy, sy * sx, -sy * cx], [0.0, cx, sx], [sy, -cy * sx, cy * cx]])
    scale = rotation[2, 2]
    return np.array([[scale, 0.0, sy * cx], [0.0, scale, -sx], [0.0, 0.0, 1.0]]) @ rotation


def tilt(x: Array, y: Array, tau_x: Angle, tau_y: Angle) -> tuple[Array, Array]:
    """Return the coordinates on the tilted sensor; NaN for directions that run parallel to it or away from it."""
    q1, q2, q3 = _rotate(x, y, tau_x, tau_y)
    scale = np.cos(tau_x) * np.cos(tau_y)
    return scale * q1 / q3 + np.sin(tau_y) * np.cos(tau_x), scale * q2 / q3 - np.sin(tau_x)


def untilt(x: Array, y: Array, tau_x: Angle, tau_y: Angle) -> tuple[Array, Array]:
    """Return the coordinates on the untilted sensor: the inverse of `tilt`."""
    inverse = np.linalg.inv(compute_homography(float(tau_x), float(tau_y)))
    u, v, w = (row[0] * x + row[1] * y + row[2] for row in inverse)
    return u / w, v / w


def differentiate(x: Array, y: Array, tau_x: Angle, tau_y: Angle) -> tuple[Array, Array, Array, Array]:
    """Return ∂x'/∂x, ∂x'/∂y, ∂y'/∂x and ∂y'/∂y of `tilt`."""
    sx, cx, sy, cy = np.sin(tau_x), np.cos(tau_x), np.sin(tau_y), np.cos(tau_y)
    q1, q2, q3 = _rotate(x, y, tau_x, tau_y)
    scale = cx * cy / (q3 * q3)
    return (
        scale * (cy * q3 - sy * q1),
        scale * (sy * sx * q3 + cy * sx * q1),
        scale * (-sy * q2),
        scale * (cx * q3 + cy * sx * q2),
    )


def differentiate_by_angles(
    x: Array, y: Array, tau_x: Angle, tau_y: Angle
) -> tuple[Array, Array, Array, Array]:
    """Return ∂x'/∂τx, ∂y'/∂τx, ∂x'/∂τy and ∂y'/∂τy of `tilt`."""
    sx, cx, sy, cy = np.sin(tau_x), np.cos(tau_x), np.sin(tau_y), np.cos(tau_y)
    q1, q2, q3 = _rotate(x, y, tau_x, tau_y)
    u, v = q1 / q3, q2 / q3
    by_x = sy * cx * y + sy * sx, cx - sx * y, -cy * cx * y - cy * sx
    by_y = -sy * x + cy * sx * y - cy * cx, np.zeros_like(x), cy * x + sy * sx * y - sy * cx
    return (
        cx * cy * (by_x[0] - u * by_x[2]) / q3 - sx * cy * u - sy * sx,
        cx * cy * (by_x[1] - v * by_x[2]) / q3 - sx * cy * v - cx,
        cx * cy * (by_y[0] - u * by_y[2]) / q3 - cx * sy * u + cy * cx,
        cx * cy * (by_y[1] - v * by_y[2]) / q3 - cx * sy * v,
    )


def _rotate(x: Array, y: Array, tau_x: Angle, tau_y: Angle) -> tuple[Array, Array, Array]:
    """Return q = R (x, y, 1), its third coordinate NaN where it is not positive."""
    sx, cx, sy, cy = np.sin(tau_x), np.cos(tau_x), np.sin(tau_y), np.cos(tau_y)
    q3 = sy * x - cy * sx * y + cy * cx
    return cy * x + sy * sx * y - sy * cx, cx * y + sx, np.where(q3 > 0, q3, np.nan)
