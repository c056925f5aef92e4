"""Projection of the core's pixels into an auxiliary, and bilinear samples there, for the reference kernels.

The projection takes pixels with their inverse depth: native/view.hpp in float64.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Array
from beltscape.core.geometry.lens import BROWN, FISHEYE, THIN_PRISM
from beltscape.kernels.projection import CODES


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


def is_inside(shape: tuple[int, ...], u: Array, v: Array) -> NDArray[np.bool_]:
    """Return where the 2 × 2 footprint of (u, v) is within an image (h, w)."""
    return (u >= 0) & (u < shape[1] - 1) & (v >= 0) & (v < shape[0] - 1)


def centred_windows(image: Array) -> Array:
    """Return (9, H, W) the 3 × 3 neighbours of every pixel less their mean, the border repeated."""
    height, width = image.shape
    padded = np.pad(image, 1, mode="edge")
    windows = np.stack([padded[y : y + height, x : x + width] for y in range(3) for x in range(3)])
    return windows - windows.mean(axis=0)


def bilinear(image: Array, u: Array, v: Array) -> Array:
    """Return the image (h, w) at (u, v); NaN where the 2 × 2 footprint is not inside."""
    inside = is_inside(image.shape, u, v)
    u, v = np.where(inside, u, 0), np.where(inside, v, 0)
    x, y = u.astype(int), v.astype(int)
    u, v = u - x, v - y
    above = (1 - u) * image[y, x] + u * image[y, x + 1]
    below = (1 - u) * image[y + 1, x] + u * image[y + 1, x + 1]
    return np.where(inside, (1 - v) * above + v * below, np.nan)


def interpolate_cubic(image: Array, u: Array, v: Array) -> Array:
    """Return the image (h, w) at (u, v) by Keys' cubic (1981); NaN where the 4 × 4 footprint is not inside."""
    inside = (u >= 1) & (u < image.shape[1] - 2) & (v >= 1) & (v < image.shape[0] - 2)
    u, v = np.where(inside, u, 1), np.where(inside, v, 1)
    x, y = u.astype(int), v.astype(int)
    found = np.full(u.shape, np.nan)
    if inside.any():
        across, down = _weigh_cubic(u - x), _weigh_cubic(v - y)
        taps = [[image[y + i - 1, x + j - 1] for j in range(4)] for i in range(4)]
        rows = [sum(w * tap for w, tap in zip(across, row, strict=True)) for row in taps]
        found = sum(w * row for w, row in zip(down, rows, strict=True))
    return np.where(inside, found, np.nan)


def _weigh_cubic(at: Array) -> list[Array]:
    """Return the weights of the pixels at −1, 0, 1 and 2 for a place ``at`` 0 … 1 (Keys' kernel with a = −1/2)."""
    return [
        at**2 - (at**3 + at) / 2,
        1.5 * at**3 - 2.5 * at**2 + 1,
        2 * at**2 - 1.5 * at**3 + at / 2,
        (at**3 - at**2) / 2,
    ]


def window_dissimilarity(core: Array, auxiliary: Array, floor: float) -> Array:
    """Return (H, W) the normalised squared difference of two centred windows (9, H, W), 0 … 1; 1 where one is NaN.

    ``floor`` is the variance that counts as noise; every pixel of both windows adds it to their energy.
    """
    energy = (core**2).sum(axis=0) + (auxiliary**2).sum(axis=0) + 2 * len(core) * floor
    c = ((core - auxiliary) ** 2).sum(axis=0) / energy
    return np.where(np.isnan(c), 1, np.minimum(c, 1))
