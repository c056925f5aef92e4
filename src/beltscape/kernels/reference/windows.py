"""Statistics of windows about given cells of a field, and lines over it, for the reference of the holes.

Sums over windows are taken by summed-area tables: a window of any size costs four look-ups
(F. C. Crow, Summed-area tables for texture mapping, SIGGRAPH 1984, doi:10.1145/800031.808600).
"""

from __future__ import annotations

from collections.abc import Iterator
from math import comb
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.kernels.arrays import CellIndices
from beltscape.kernels.holes import (
    FEWEST,
    LEAST_SHARE,
    LEAST_SPREAD,
    MOST_LEVERAGE,
    RIDGE,
    SLOPE_SIDE,
    TERMS,
)

_BAND_ROWS = 128
"""Rows whose cells share a table of running sums, so that the table and its rounding errors stay small."""


def cut_bands(cells: CellIndices, reach: int, rows: int) -> Iterator[tuple[NDArray[np.intp], slice]]:
    """Yield the indices of cells in one band of a field's ``rows``, and the rows up to ``reach`` about them."""
    if not len(cells[0]):
        return
    for first in range(int(cells[0].min()), int(cells[0].max()) + 1, _BAND_ROWS):
        own = np.flatnonzero((cells[0] >= first) & (cells[0] < first + _BAND_ROWS))
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


def fit_quadratics(
    field: NDArray[np.float64], cells: CellIndices, sides: tuple[int, ...]
) -> NDArray[np.float64]:
    """Return (3, K, H) value, miss and leverage of least-squares quadratics in windows of K sides about H cells.

    The value is that at the cell itself. The miss is the root mean square residual of the window's measured cells,
    the leverage the variance of the value times the number of cells, over one cell's: 1 for a mean, more beyond. All
    are NaN where the window does not determine a quadratic. Nothing lies outside the field, whose mean should be
    near 0, because its squares are summed.
    """
    measured = np.isfinite(field)
    height = np.where(measured, field, 0.0)
    found = np.empty((3, len(sides), len(cells[0])))
    half = np.array(sides)[:, None] / 2
    for own, near in cut_bands(cells, max(sides) // 2, len(field)):
        x, y = (np.arange(int(count)) - count // 2 for count in (field.shape[1], near.stop - near.start))
        masses = WindowSums(_weighted(measured[near].astype(np.int64), x, y, _POWERS))
        heights = WindowSums(_weighted(height[near], x, y, TERMS))
        squares = WindowSums(height[near][None] ** 2)
        at = (cells[0][own] - near.start, cells[1][own])
        mass, right, square = (
            np.stack([table.at(at, side) for side in sides], axis=1) for table in (masses, heights, squares)
        )
        found[:, :, own] = _solved(mass, right, square[0], x[at[1]], y[at[0]], half)
    return found


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


def window_means(
    field: NDArray[np.float64], cells: CellIndices, sides: tuple[int, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the share of measured cells in windows and their mean, (K, H) each; the border is repeated outside.

    The mean is NaN where fewer than `LEAST_SHARE` are measured.
    """
    reach = max(sides) // 2
    shares, means = np.empty((2, len(sides), len(cells[0])))
    for own, near in cut_bands(cells, reach, len(field)):
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


def window_minima(
    field: NDArray[np.float64], cells: CellIndices, sides: tuple[int, ...]
) -> NDArray[np.float64]:
    """Return the (K, H) least measured values in windows; NaN where there is none."""
    known = np.where(np.isfinite(field), field, np.inf)
    low = np.stack([ndimage.minimum_filter(known, side, mode="nearest")[cells] for side in sides])
    return np.where(np.isfinite(low), low, np.nan)


def collect_bends(field: NDArray[np.float64], half: int, above: float) -> NDArray[np.float64]:
    """Return the bends of a field at a distance, along both axes together.

    A cell's bend is the distance of its value from the mean of the two cells ``half`` cells before and after it,
    all three measured, and its own value greater than ``above``.
    """
    collected = [np.empty(0)]
    for values in (field, field.T):
        if len(values) > 2 * half:
            here = values[half:-half]
            with np.errstate(invalid="ignore"):
                bend = np.abs(here - 0.5 * (values[2 * half :] + values[: -2 * half]))
            collected.append(bend[np.isfinite(bend) & (here > above)])
    return np.concatenate(collected)


def fit_plane_slopes(field: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (2, Ny, Nx) slopes in x and y, per cell, of the plane through the measured cells about each.

    The window's side is `SLOPE_SIDE`. Slopes are 0 where fewer cells than that are measured, or all on a line.
    """
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
    return np.where(sound, slope, 0.0)


class FirstHits(NamedTuple):
    """End points of D lines from each of H cells."""

    cell: NDArray[np.int64]
    """(D, H) flat index of the cell, -1 where there is none."""
    steps: NDArray[np.float64]
    """(D, H) number of steps to it, inf where there is none."""


def find_first_hits(
    measured: NDArray[np.bool_],
    cells: CellIndices,
    down: NDArray[np.float64],
    across: NDArray[np.float64],
    most: int,
) -> FirstHits:
    """Return the first measured cell along lines from given cells, within ``most`` steps.

    From cell (r, c) the k-th step leads to (r + rint(k down), c + rint(k across)), from k = 1 on; rint rounds to
    the nearest whole number, and halves to the even one. ``down`` and ``across`` (D, H) or (D, 1) are -1 to 1.
    """
    rows, columns = measured.shape
    shape = (len(down), len(cells[0]))
    cell, steps = np.full(shape, -1, np.int64).ravel(), np.full(shape, np.inf).ravel()
    start, down, across = (
        np.broadcast_to(part, shape).ravel() for part in (cells[0] * columns + cells[1], down, across)
    )
    going = np.arange(start.size)
    for step in range(1, most + 1):
        row = start[going] // columns + np.rint(step * down[going]).astype(np.int64)
        column = start[going] % columns + np.rint(step * across[going]).astype(np.int64)
        inside = (row >= 0) & (column >= 0) & (row < rows) & (column < columns)
        going, flat = going[inside], (row * columns + column)[inside]
        if not len(going):
            break
        hit = measured.ravel()[flat]
        cell[going[hit]], steps[going[hit]] = flat[hit], step
        going = going[~hit]
    return FirstHits(cell.reshape(shape), steps.reshape(shape))
