"""Quadratics in windows: the reference of `quadratics`."""

from __future__ import annotations

from math import comb
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.images.window_statistics import FEWEST, MOST_LEVERAGE, RIDGE, TERMS, WindowsInput
from beltscape.kernels.reference.images.window_sums import WindowSums, bands

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
