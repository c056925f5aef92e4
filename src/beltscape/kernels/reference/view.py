"""Projection of the core's pixels with their inverse depth into an auxiliary: native/view.hpp in float64."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.lens import BROWN

Array = NDArray[np.float64]


def project(view: NDArray[np.floating], u: Array, v: Array, s: Array) -> tuple[Array, Array, Array]:
    """Return the auxiliary's pixel (u, v) and the inverse depth from it, of core pixels (u, v) at inverse depth s.

    Shapes broadcast. ``view`` is (21,): direction (9, row by row), shift (3), focal u, v, centre u, v, k1, k2, p1,
    p2, k3. The point lies at direction @ (u, v, 1) + shift · s in the auxiliary's frame, up to scale. The results are
    NaN where it does not lie in front of the auxiliary.
    """
    view = np.asarray(view, np.float64)
    direction, shift = view[:9].reshape(3, 3), view[9:12]
    (focal_u, focal_v, center_u, center_v), coefficients = view[12:16], view[16:]
    point = [row[0] * u + row[1] * v + row[2] + t * s for row, t in zip(direction, shift, strict=True)]
    depth = np.where(point[2] > 0, point[2], np.nan)
    x, y = BROWN.distort(point[0] / depth, point[1] / depth, coefficients)
    return x * focal_u + center_u, y * focal_v + center_v, s / depth
