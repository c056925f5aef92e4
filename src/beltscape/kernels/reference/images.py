"""The references of the kernels of images: gathering, splines and warps."""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Array
from beltscape.kernels.images import GatherInput, SplineInput, WarpInput
from beltscape.kernels.reference.view import project


def gather(given: GatherInput) -> tuple[NDArray[np.float32]]:
    """Return the values (P K, N)."""
    height, width = given.planes[0].shape
    du, dv = given.offsets.T[..., None]
    row = np.clip(given.v.astype(int) + dv, 0, height - 1)
    column = np.clip(given.u.astype(int) + du, 0, width - 1)
    return (np.concatenate([plane[row, column] for plane in given.planes]),)


STEP = 1e-3
"""Step of s for slopes by central differences; the projection is smooth over a much larger range."""


def spline_coefficients(given: SplineInput) -> tuple[Array]:
    """Return the coefficients (h, w)."""
    grey = np.asarray(given.image, np.float64)
    along_columns = np.linalg.solve(_values(grey.shape[0]), grey)
    return (np.asarray(np.linalg.solve(_values(grey.shape[1]), along_columns.T).T, np.float64),)


def _values(n: int) -> Array:
    """Return (n, n) the matrix from the coefficients of n mirrored pixels to their values: 1/6, 4/6, 1/6."""
    if n == 1:
        return np.eye(1)
    matrix = (np.eye(n, k=-1) + 4 * np.eye(n) + np.eye(n, k=1)) / 6
    matrix[0, 1] += 1 / 6
    matrix[-1, -2] += 1 / 6
    return matrix


def warp(given: WarpInput) -> tuple[Array, Array]:
    """Return value and slope, (H, W) each."""
    s, view, taps = np.asarray(given.s, np.float64), given.view, np.asarray(given.coefficients, np.float64)
    y, x = cast("NDArray[np.int64]", np.indices(s.shape))
    u, v, _ = project(view, x, y, s)
    ahead, behind = project(view, x, y, s + STEP), project(view, x, y, s - STEP)
    value, by_u, by_v = sample(taps, u, v)
    slope = (by_u * (ahead[0] - behind[0]) + by_v * (ahead[1] - behind[1])) / (2 * STEP)
    return value, np.where(np.isnan(value), 0.0, slope)


def sample(coefficients: Array, u: Array, v: Array) -> tuple[Array, Array, Array]:
    """Return the spline's value and slopes along u and v at (u, v); NaN where its 4 × 4 (of h, w) leave the image."""
    height, width = coefficients.shape
    inside = (u >= 1) & (u < width - 2) & (v >= 1) & (v < height - 2)
    u, v = np.where(inside, u, 1.0), np.where(inside, v, 1.0)
    value, by_u, by_v = (np.where(inside, 0.0, np.nan) for _ in range(3))
    for column in range(-1, 3):
        for row in range(-1, 3):
            x, y = np.floor(u).astype(int) + column, np.floor(v).astype(int) + row
            value += coefficients[y, x] * bump(u - x) * bump(v - y)
            by_u += coefficients[y, x] * bump_slope(u - x) * bump(v - y)
            by_v += coefficients[y, x] * bump(u - x) * bump_slope(v - y)
    return value, by_u, by_v


def bump(x: Array) -> Array:
    """Return the cubic B-spline β³ (Unser et al. 1993)."""
    x = np.abs(x)
    return np.where(x < 1, 2 / 3 - x * x * (2 - x) / 2, np.maximum(2 - x, 0) ** 3 / 6)


def bump_slope(x: Array) -> Array:
    """Return the derivative of β³."""
    a = np.abs(x)
    return np.sign(x) * np.where(a < 1, a * (1.5 * a - 2), -(np.maximum(2 - a, 0) ** 2) / 2)
