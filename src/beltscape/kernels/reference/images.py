"""The references of the kernels of images: gathering, splines and warps, and statistics of windows.

Sums over windows are taken by summed-area tables: a window of any size costs four look-ups
(F. C. Crow, Summed-area tables for texture mapping, SIGGRAPH 1984, doi:10.1145/800031.808600).
"""

from __future__ import annotations

from collections.abc import Iterator
from math import comb
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.arrays import Array
from beltscape.kernels.arrays import CellIndices
from beltscape.kernels.images import (
    BAND_ROWS,
    FEWEST,
    LEAST_SHARE,
    LEAST_SPREAD,
    MOST_LEVERAGE,
    RIDGE,
    SLOPE_SIDE,
    TERMS,
    BendsInput,
    FieldInput,
    GatherInput,
    SplineInput,
    WarpInput,
    WindowsInput,
)
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


def bands(cells: CellIndices, reach: int, rows: int) -> Iterator[tuple[NDArray[np.intp], slice]]:
    """Yield the indices of cells in one band of a field's ``rows``, and the rows up to ``reach`` about them."""
    if not len(cells[0]):
        return
    for first in range(int(cells[0].min()), int(cells[0].max()) + 1, BAND_ROWS):
        own = np.flatnonzero((cells[0] >= first) & (cells[0] < first + BAND_ROWS))
        if len(own):
            low, high = int(cells[0][own].min()), int(cells[0][own].max())
            yield own, slice(max(low - reach, 0), min(high + reach + 1, rows))


class WindowSums:
    """Summed-area tables of F fields. Whole numbers may overflow: sums of windows are exact nevertheless."""

    def __init__(self, fields: NDArray[np.int64] | NDArray[np.float64]) -> None:
        """Sum up ``fields`` (F, Ny, Nx), int64 or float64."""
        count, rows, columns = fields.shape
        self._shape = (rows, columns)
        table = np.zeros((count, rows + 1, columns + 1), fields.dtype)
        np.cumsum(fields, axis=2, out=table[:, 1:, 1:])
        for row in range(1, rows):
            table[:, row + 1, 1:] += table[:, row, 1:]
        self._table = table.reshape(count, -1)

    def at(self, cells: CellIndices, side: int) -> NDArray[Any]:
        """Return (F, H) sums over windows of odd ``side`` cells about H cells; nothing lies outside the fields."""
        rows, columns = self._shape
        half = side // 2
        top, bottom = np.maximum(cells[0] - half, 0), np.minimum(cells[0] + half + 1, rows)
        left, right = np.maximum(cells[1] - half, 0), np.minimum(cells[1] + half + 1, columns)
        table, stride = self._table, columns + 1
        lower, upper = bottom * stride, top * stride
        return (
            table[:, lower + right]
            - table[:, lower + left]
            - table[:, upper + right]
            + table[:, upper + left]
        )


_POWERS = tuple((i, j) for i in range(5) for j in range(5 - i))
"""Powers of x and y in the normal equations of a quadratic: products of two of its `TERMS`."""
_LEAST_PIVOT = 1e-30
"""Lower bound of a pivot, so that rounding errors leave a root; sound windows stay above by `RIDGE`."""


def quadratics(given: WindowsInput) -> list[NDArray[np.float64]]:
    """Return value, miss and leverage, (K, H) each."""
    field, cells, sides = given.field, (given.rows, given.columns), given.sides.tolist()
    measured = np.isfinite(field)
    height = np.where(measured, field, 0.0)
    found = np.empty((3, len(sides), len(cells[0])))
    half = np.array(sides)[:, None] / 2
    for own, near in bands(cells, max(sides) // 2, len(field)):
        x, y = (np.arange(int(count)) - count // 2 for count in (field.shape[1], near.stop - near.start))
        masses = WindowSums(_weighted(measured[near].astype(np.int64), x, y, _POWERS))
        heights = WindowSums(_weighted(height[near], x, y, TERMS))
        squares = WindowSums(height[near][None] ** 2)
        at = (cells[0][own] - near.start, cells[1][own])
        mass, right, square = (
            np.stack([table.at(at, side) for side in sides], axis=1) for table in (masses, heights, squares)
        )
        found[:, :, own] = _solved(mass, right, square[0], x[at[1]], y[at[0]], half)
    return list(found)


def _weighted(
    field: NDArray[Any], x: NDArray[np.int64], y: NDArray[np.int64], powers: tuple[tuple[int, int], ...]
) -> NDArray[Any]:
    """Return (len(powers), Ny, Nx) a field (Ny, Nx) times powers of x (Nx,) and y (Ny,)."""
    along = {i: field * x**i for i in {power[0] for power in powers}}
    return np.stack([along[i] * y[:, None] ** j if j else along[i] for i, j in powers])


def _solved(
    masses: NDArray[np.int64],
    heights: NDArray[np.float64],
    square: NDArray[np.float64],
    at_x: NDArray[np.int64],
    at_y: NDArray[np.int64],
    half: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return (3, K, n) value, miss and leverage from the windows' sums of powers (P, K, n)."""
    powers_x, powers_y = (_powers(-at) for at in (at_x, at_y))
    mass = {(i, j): _moved(masses, _POWERS, (i, j), powers_x, powers_y) / half ** (i + j) for i, j in _POWERS}
    right = np.stack([_moved(heights, TERMS, (i, j), powers_x, powers_y) / half ** (i + j) for i, j in TERMS])
    number = mass[0, 0]
    normal = np.stack([np.stack([mass[a + c, b + d] for c, d in TERMS]) for a, b in TERMS])
    normal[range(len(TERMS)), range(len(TERMS))] += RIDGE * np.maximum(number, 1.0)
    unit = np.zeros_like(right)
    unit[0] = 1.0
    solution, inverse = _cholesky_solved(normal, (right, unit))
    leverage = inverse[0] * number
    rest = np.maximum(square - (solution * right).sum(axis=0), 0.0)
    found = np.stack([solution[0], np.sqrt(rest / np.maximum(number, 1.0)), leverage])
    return np.where((number > FEWEST - 0.5) & (leverage > 0) & (leverage < MOST_LEVERAGE), found, np.nan)


def _cholesky_solved(
    matrix: NDArray[np.float64], rights: tuple[NDArray[np.float64], ...]
) -> list[NDArray[np.float64]]:
    """Solve n small positive definite systems (k, k, n) at once for right sides (k, n)."""
    size = len(matrix)
    lower = np.zeros_like(matrix)
    for j in range(size):
        pivot = matrix[j, j] - (lower[j, :j] ** 2).sum(axis=0)
        lower[j, j] = np.sqrt(np.maximum(pivot, _LEAST_PIVOT))
        for i in range(j + 1, size):
            lower[i, j] = (matrix[i, j] - (lower[i, :j] * lower[j, :j]).sum(axis=0)) / lower[j, j]
    found: list[NDArray[np.float64]] = []
    for right in rights:
        part = np.empty_like(right)
        for j in range(size):
            part[j] = (right[j] - (lower[j, :j] * part[:j]).sum(axis=0)) / lower[j, j]
        for j in reversed(range(size)):
            part[j] = (part[j] - (lower[j + 1 :, j] * part[j + 1 :]).sum(axis=0)) / lower[j, j]
        found.append(part)
    return found


def _powers(values: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    return [values**power for power in range(5)]


def _moved(
    sums: NDArray[Any],
    powers: tuple[tuple[int, int], ...],
    power: tuple[int, int],
    powers_x: list[NDArray[np.int64]],
    powers_y: list[NDArray[np.int64]],
) -> NDArray[Any]:
    """Return (K, n) sums of a power about the cells themselves by the binomial theorem.

    ``powers_x`` and ``powers_y`` are powers of the negated cell indices (n,).
    """
    i, j = power
    total = sums[powers.index(power)]
    for a in range(i + 1):
        for b in range(j + 1):
            if (a, b) != power:
                weight = (comb(i, a) * comb(j, b)) * powers_x[i - a] * powers_y[j - b]
                total = total + weight * sums[powers.index((a, b))]
    return total


def window_means(given: WindowsInput) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return share and mean, (K, H) each."""
    field, cells, sides = given.field, (given.rows, given.columns), given.sides.tolist()
    reach = max(sides) // 2
    shares, means = np.empty((2, len(sides), len(cells[0])))
    for own, near in bands(cells, reach, len(field)):
        padded = np.pad(field[near], reach, mode="edge")
        known = np.isfinite(padded)
        counts = WindowSums(known[None].astype(np.int64))
        totals = WindowSums(np.where(known, padded, 0.0)[None])
        at = (cells[0][own] - near.start + reach, cells[1][own] + reach)
        for k, side in enumerate(sides):
            share, total = counts.at(at, side)[0] / side**2, totals.at(at, side)[0] / side**2
            shares[k, own] = share
            means[k, own] = np.where(share > LEAST_SHARE, total / np.maximum(share, LEAST_SHARE), np.nan)
    return shares, means


def window_minima(given: WindowsInput) -> tuple[NDArray[np.float64]]:
    """Return the least values (K, H)."""
    field, cells, sides = given.field, (given.rows, given.columns), given.sides.tolist()
    known = np.where(np.isfinite(field), field, np.inf)
    low = np.stack([ndimage.minimum_filter(known, side, mode="nearest")[cells] for side in sides])
    return (np.where(np.isfinite(low), low, np.nan),)


def bend_medians(given: BendsInput) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the number of bends (K,) and their median (K,)."""
    bends = [_collect_bends(given.field, int(half), given.above) for half in given.halves]
    medians = [float(np.median(values)) if len(values) else np.nan for values in bends]
    return np.array([len(values) for values in bends], np.int64), np.array(medians, np.float64)


def _collect_bends(field: NDArray[np.float64], half: int, above: float) -> NDArray[np.float64]:
    collected = [np.empty(0)]
    for values in (field, field.T):
        if len(values) > 2 * half:
            here = values[half:-half]
            with np.errstate(invalid="ignore"):
                bend = np.abs(here - 0.5 * (values[2 * half :] + values[: -2 * half]))
            collected.append(bend[np.isfinite(bend) & (here > above)])
    return np.concatenate(collected)


def plane_slopes(given: FieldInput) -> tuple[NDArray[np.float64]]:
    """Return the slopes (2, Ny, Nx)."""
    (field,) = given
    finite = np.isfinite(field)
    measured, z = finite.astype(np.float64), np.where(finite, field, 0.0)
    k = np.arange(SLOPE_SIDE) - SLOPE_SIDE // 2
    even, odd, square = np.ones(SLOPE_SIDE), k.astype(np.float64), (k * k).astype(np.float64)

    def moment(
        values: NDArray[np.float64], down: NDArray[np.float64], across: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        part = ndimage.correlate1d(values, down, axis=0, mode="constant")
        return np.asarray(ndimage.correlate1d(part, across, axis=1, mode="constant"), np.float64)

    number = np.maximum(moment(measured, even, even), 1.0)
    x, y = moment(measured, even, odd), moment(measured, odd, even)
    total, sum_x, sum_y = moment(z, even, even), moment(z, even, odd), moment(z, odd, even)
    xx = moment(measured, even, square) - x * x / number
    yy = moment(measured, square, even) - y * y / number
    xy = moment(measured, odd, odd) - x * y / number
    xz, yz = sum_x - x * total / number, sum_y - y * total / number
    spread = xx * yy - xy * xy
    sound = (spread > LEAST_SPREAD * xx * yy) & (number >= SLOPE_SIDE) & finite
    spread = np.where(sound, spread, 1.0)
    slope = np.stack([xz * yy - yz * xy, yz * xx - xz * xy]) / spread
    return (np.where(sound, slope, 0.0),)
