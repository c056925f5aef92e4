"""The lens model: OpenCV's radial and tangential distortion of image-plane coordinates, with its derivatives.

With r² = x² + y² and the coefficients k1, k2, p1, p2, k3 (Brown 1971; OpenCV's order)

    x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²)
    y' = y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2 y²) + 2 p2 x y.

Every Python module that needs the model calls these functions; `native/view.hpp` holds it once more for the kernels.

References
----------
D. C. Brown, Close-range camera calibration, Photogrammetric Engineering 37(8), 855-866, 1971.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]


def distort(x: Array, y: Array, coefficients: Array) -> tuple[Array, Array]:
    """Return the distorted coordinates of undistorted image-plane coordinates.

    Parameters
    ----------
    x, y
        x/z and y/z, of any shape.
    coefficients
        (5,) k1, k2, p1, p2, k3; or (5, N), of each of N points.
    """
    _, _, p1, p2, _ = coefficients
    xx, xy, yy = x * x, x * y, y * y
    r2 = xx + yy
    radial = _radial(r2, coefficients)
    return (
        x * radial + p1 * (2 * xy) + p2 * (r2 + 2 * xx),
        y * radial + p1 * (r2 + 2 * yy) + p2 * (2 * xy),
    )


def differentiate(x: Array, y: Array, coefficients: Array) -> tuple[Array, Array, Array]:
    """Return the derivatives ∂x'/∂x, ∂x'/∂y = ∂y'/∂x and ∂y'/∂y of `distort`; parameters as there."""
    k1, k2, p1, p2, k3 = coefficients
    xx, xy, yy = x * x, x * y, y * y
    r2 = xx + yy
    radial = _radial(r2, coefficients)
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))  # 2 ∂radial/∂r²; times x it is ∂radial/∂x
    return (
        radial + slope * xx + 2 * p1 * y + 6 * p2 * x,
        slope * xy + 2 * (p1 * x + p2 * y),
        radial + slope * yy + 6 * p1 * y + 2 * p2 * x,
    )


def differentiate_by_coefficients(x: Array, y: Array, focal_x: Array, focal_y: Array) -> Array:
    """Return the derivatives (5, 2, ...) of a pixel (focal_x · x', focal_y · y') by k1, k2, p1, p2, k3."""
    xx, xy, yy = x * x, x * y, y * y
    r2 = xx + yy
    radial = np.array([focal_x * x * r2, focal_y * y * r2])
    by_p1 = [focal_x * (2 * xy), focal_y * (r2 + 2 * yy)]
    by_p2 = [focal_x * (r2 + 2 * xx), focal_y * (2 * xy)]
    return np.array([radial, radial * r2, by_p1, by_p2, radial * r2 * r2])


def _radial(r2: Array, coefficients: Array) -> Array:
    k1, k2, _, _, k3 = coefficients
    return 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
