"""Projection of the core's pixels with their inverse depth into an auxiliary: native/view.hpp in float64."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def project(view: NDArray[np.floating], u: Array, v: Array, s: Array) -> tuple[Array, Array, Array]:
    """Return the auxiliary's pixel (u, v) and the inverse depth from it, of core pixels (u, v) at inverse depth s.

    Shapes broadcast. ``view`` is (21,): direction (9, row by row), shift (3), focal u, v, centre u, v, k1, k2, p1,
    p2, k3. The point lies at direction @ (u, v, 1) + shift · s in the auxiliary's frame, up to scale. The results are
    NaN where it does not lie in front of the auxiliary.
    """
    view = np.asarray(view, np.float64)
    direction, shift = view[:9].reshape(3, 3), view[9:12]
    (focal_u, focal_v, center_u, center_v), (k1, k2, p1, p2, k3) = view[12:16], view[16:]
    point = [row[0] * u + row[1] * v + row[2] + t * s for row, t in zip(direction, shift, strict=True)]
    depth = np.where(point[2] > 0, point[2], np.nan)
    x, y = point[0] / depth, point[1] / depth
    rr = x * x + y * y
    radial = 1 + rr * (k1 + rr * (k2 + rr * k3))
    distorted_x = x * radial + 2 * p1 * x * y + p2 * (rr + 2 * x * x)
    distorted_y = y * radial + p1 * (rr + 2 * y * y) + 2 * p2 * x * y
    return distorted_x * focal_u + center_u, distorted_y * focal_v + center_v, s / depth
