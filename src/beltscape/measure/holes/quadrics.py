"""Quadratic surfaces through the measured cells about places: how a smooth surface would go on there."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.measure.holes.windows import Place, WindowSums, bands

_TERMS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
"""Powers of x and y."""
_POWERS = tuple((i, j) for i in range(5) for j in range(5 - i))
_FEWEST = 12
"""Cells that six coefficients need."""
_LEVERAGE = 30.0
"""Variance of the value, times the number of cells, of one cell's; from here on it is extrapolated too far."""
_RIDGE = 1e-6
"""Share of the cells that keeps cells all on a line from carrying one, above what is lost by rounding."""
_AT_ONCE = 1 << 11
"""Places solved together: what they need stays small."""


@dataclass(frozen=True, slots=True, eq=False)
class Quadrics:
    """Least-squares quadratics in windows of K sizes about H places, NaN where the cells do not carry one."""

    value_mm: NDArray[np.float64]
    """(K, H) at the place itself."""
    miss_mm: NDArray[np.float64]
    """(K, H) root mean square by which the measured cells of the window miss it: 0 on a smooth surface."""
    leverage: NDArray[np.float64]
    """(K, H) variance of the value in units of one cell's over their number: 1 for a mean, much if extrapolated."""


def quadrics(value_mm: NDArray[np.float64], place: Place, sides: tuple[int, ...]) -> Quadrics:
    """Fit the measured cells of a field (Ny, Nx) in windows of odd ``sides`` cells about places (row, column)."""
    measured = np.isfinite(value_mm)
    # about the field's own middle, so that squares do not drown in rounding
    middle = float(np.nanmean(value_mm))
    height = np.where(measured, value_mm - middle, 0.0)
    found = np.empty((3, len(sides), len(place[0])))
    half = np.array(sides)[:, None] / 2
    for own, near in bands(place, max(sides) // 2, len(value_mm)):
        x, y = (np.arange(count) - count // 2 for count in (value_mm.shape[1], near.stop - near.start))
        masses = WindowSums(_weighted(measured[near].astype(np.int64), x, y, _POWERS))
        heights = WindowSums(_weighted(height[near], x, y, _TERMS))
        squares = WindowSums(height[near][None] ** 2)
        for first in range(0, len(own), _AT_ONCE):
            part = own[first : first + _AT_ONCE]
            at = (place[0][part] - near.start, place[1][part])
            mass, right, square = (
                np.stack([table.at(at, side) for side in sides], axis=1)
                for table in (masses, heights, squares)
            )
            found[:, :, part] = _solved(mass, right, square[0], x[at[1]], y[at[0]], half)
    return Quadrics(found[0] + middle, found[1], found[2])


def _weighted(
    field: NDArray[Any], x: NDArray[np.int64], y: NDArray[np.int64], powers: tuple[tuple[int, int], ...]
) -> NDArray[Any]:
    """(len(powers), Ny, Nx) a field (Ny, Nx) times powers of x (Nx,) and y (Ny,)."""
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
    """(3, K, n) value, miss and leverage from the windows' sums of powers (P, K, n)."""
    powers_x, powers_y = (_powers(-at) for at in (at_x, at_y))
    mass = {(i, j): _moved(masses, _POWERS, (i, j), powers_x, powers_y) / half ** (i + j) for i, j in _POWERS}
    right = np.stack(
        [_moved(heights, _TERMS, (i, j), powers_x, powers_y) / half ** (i + j) for i, j in _TERMS]
    )
    number = mass[0, 0]
    normal = np.stack([np.stack([mass[a + c, b + d] for c, d in _TERMS]) for a, b in _TERMS])
    normal[range(len(_TERMS)), range(len(_TERMS))] += _RIDGE * np.maximum(number, 1.0)
    unit = np.zeros_like(right)
    unit[0] = 1.0
    solution, inverse = _cholesky_solved(normal, (right, unit))
    leverage = inverse[0] * number
    rest = np.maximum(square - (solution * right).sum(axis=0), 0.0)
    found = np.stack([solution[0], np.sqrt(rest / np.maximum(number, 1.0)), leverage])
    return np.where((number > _FEWEST - 0.5) & (leverage > 0) & (leverage < _LEVERAGE), found, np.nan)


def _cholesky_solved(
    matrix: NDArray[np.float64], rights: tuple[NDArray[np.float64], ...]
) -> list[NDArray[np.float64]]:
    """Solve many small positive definite systems (k, k, n) at once, for right sides (k, n): fast as n is long."""
    size = len(matrix)
    lower = np.zeros_like(matrix)
    for j in range(size):
        pivot = matrix[j, j] - (lower[j, :j] ** 2).sum(axis=0)
        lower[j, j] = np.sqrt(np.maximum(pivot, 1e-30))
        for i in range(j + 1, size):
            lower[i, j] = (matrix[i, j] - (lower[i, :j] * lower[j, :j]).sum(axis=0)) / lower[j, j]
    found = []
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
    """(K, n) sum of a power about the place itself, by the binomial theorem; powers of minus its place (n,)."""
    i, j = power
    total = sums[powers.index(power)]
    for a in range(i + 1):
        for b in range(j + 1):
            if (a, b) != power:
                weight = (comb(i, a) * comb(j, b)) * powers_x[i - a] * powers_y[j - b]
                total = total + weight * sums[powers.index((a, b))]
    return total
