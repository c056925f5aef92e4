"""Quadratic surfaces through the measured cells about places: how a smooth surface would go on there."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

_TERMS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
"""Powers of x and y."""
_POWERS = tuple((i, j) for i in range(5) for j in range(5 - i))
_FEWEST = 12
"""Cells that six coefficients need."""
_LEVERAGE = 30.0
"""Variance of the value, times the number of cells, of one cell's; from here on it is extrapolated too far."""
_RIDGE = 1e-6
"""Share of the cells that keeps cells all on a line from carrying one, above what is lost by rounding."""
_AT_ONCE = 1 << 13
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


def quadrics(
    value_mm: NDArray[np.float64], place: tuple[NDArray[np.intp], NDArray[np.intp]], sides: tuple[int, ...]
) -> Quadrics:
    """Fit the measured cells of a field (Ny, Nx) in windows of odd ``sides`` cells about places (row, column)."""
    measured = np.isfinite(value_mm)
    middle = float(np.nanmean(value_mm))
    mass, height = measured.astype(np.float64), np.where(measured, value_mm - middle, 0.0)
    # about the field's own middle, so that powers do not drown in rounding
    x, y = (np.arange(count, dtype=np.float64) - count // 2 for count in reversed(value_mm.shape))
    at_x, at_y = x[place[1]], y[place[0]]
    found = np.empty((3, len(sides), len(at_x)))
    for k, side in enumerate(sides):

        def summed(field: NDArray[np.float64], side: int = side) -> NDArray[np.float64]:
            return np.asarray(ndimage.uniform_filter(field, side, mode="constant"))[place] * side**2

        masses = {(i, j): summed(mass * x**i * y[:, None] ** j) for i, j in _POWERS}
        heights = {(i, j): summed(height * x**i * y[:, None] ** j) for i, j in _TERMS}
        square = summed(height**2)
        for first in range(0, len(at_x), _AT_ONCE):
            own = slice(first, first + _AT_ONCE)
            parts = [{power: sums[own] for power, sums in group.items()} for group in (masses, heights)]
            found[:, k, own] = _solved(parts[0], parts[1], square[own], at_x[own], at_y[own], side / 2)
    return Quadrics(found[0] + middle, found[1], found[2])


def _solved(
    masses: dict[tuple[int, int], NDArray[np.float64]],
    heights: dict[tuple[int, int], NDArray[np.float64]],
    square: NDArray[np.float64],
    at_x: NDArray[np.float64],
    at_y: NDArray[np.float64],
    half: float,
) -> NDArray[np.float64]:
    """(3, n) value, miss and leverage from the windows' sums of powers."""
    powers_x, powers_y = (_powers(-at) for at in (at_x, at_y))
    mass = {power: _moved(masses, power, powers_x, powers_y, half) for power in _POWERS}
    right = np.stack([_moved(heights, power, powers_x, powers_y, half) for power in _TERMS])
    number = mass[0, 0]
    normal = np.stack([[mass[a + c, b + d] for c, d in _TERMS] for a, b in _TERMS])
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


def _powers(values: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    return [np.ones_like(values), values, values**2, values**3, values**4]


def _moved(
    sums: dict[tuple[int, int], NDArray[np.float64]],
    power: tuple[int, int],
    powers_x: list[NDArray[np.float64]],
    powers_y: list[NDArray[np.float64]],
    half: float,
) -> NDArray[np.float64]:
    """A sum of powers about the place itself, in half windows, by the binomial theorem; powers of minus its place."""
    i, j = power
    total = np.zeros_like(powers_x[0])
    for a in range(i + 1):
        for b in range(j + 1):
            total += (comb(i, a) * comb(j, b)) * powers_x[i - a] * powers_y[j - b] * sums[a, b]
    return total / half ** (i + j)
