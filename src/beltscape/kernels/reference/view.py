"""Projection of the core's pixels with their inverse depth into an auxiliary: native/view.hpp in float64."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.lens import BROWN, FISHEYE, THIN_PRISM
from beltscape.kernels.projection import CODES

Array = NDArray[np.float64]


def project(view: NDArray[np.floating], u: Array, v: Array, s: Array) -> tuple[Array, Array, Array]:
    """Return the auxiliary's pixel (u, v) and the inverse depth from it, of core pixels (u, v) at inverse depth s.

    Shapes broadcast. ``view`` (39,) is laid out in `kernels.projection`. The point lies at direction @ (u, v, 1)
    + shift · s in the auxiliary's frame, up to scale. The results are NaN where it does not lie in front of the
    auxiliary, the pixel also beyond the lens's domain of validity.
    """
    view = np.asarray(view, np.float64)
    direction, shift = view[:9].reshape(3, 3), view[9:12]
    (focal_u, focal_v, center_u, center_v), lens = view[12:16], view[16:]
    point = [row[0] * u + row[1] * v + row[2] + t * s for row, t in zip(direction, shift, strict=True)]
    depth = np.where(point[2] > 0, point[2], np.nan)
    x, y = distort(lens, point[0] / depth, point[1] / depth)
    return x * focal_u + center_u, y * focal_v + center_v, s / depth


def distort(lens: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """Return the distorted coordinates of a packed lens (23,); NaN beyond its domain of validity."""
    code, rest = lens[6], np.concatenate([lens[:5], lens[7:14]])
    x = np.where(x * x + y * y <= lens[5], x, np.nan)
    if code == CODES["fisheye"]:
        return FISHEYE.distort(x, y, lens[[0, 1, 4, 7]])
    if code == CODES["brown"]:
        return BROWN.distort(x, y, lens[:5])
    x, y = THIN_PRISM.distort(x, y, rest)
    if code != CODES["tilted"]:
        return x, y
    u, v, w = (row[0] * x + row[1] * y + row[2] for row in lens[14:].reshape(3, 3))
    w = np.where(w > 0, w, np.nan)
    return u / w, v / w
