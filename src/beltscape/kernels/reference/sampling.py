"""Bilinear samples of images and windows of their pixels, for the reference kernels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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


def window_dissimilarity(core: Array, auxiliary: Array, floor: float) -> Array:
    """Return (H, W) the normalised squared difference of two centred windows (9, H, W), 0 … 1; 1 where one is NaN.

    ``floor`` is the variance that counts as noise; every pixel of both windows adds it to their energy.
    """
    energy = (core**2).sum(axis=0) + (auxiliary**2).sum(axis=0) + 2 * len(core) * floor
    c = ((core - auxiliary) ** 2).sum(axis=0) / energy
    return np.where(np.isnan(c), 1, np.minimum(c, 1))
