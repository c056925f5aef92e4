"""The reference of the kernel of the displacement of a field of heights (kernels/least_squares.py)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from beltscape.core.statistics import MAD_TO_SIGMA
from beltscape.kernels.least_squares import (
    FIT_BIWEIGHT,
    FIT_CELLS,
    FIT_CONDITION,
    FIT_REACH,
    FIT_REWEIGHTINGS,
    FIT_ROUNDS,
    FIT_SAMPLES,
    FIT_SETTLED,
    ShiftInput,
)

_UNKNOWN = np.full(2, np.nan), np.full(1, np.nan)


def fit_shift(given: ShiftInput) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the shift (2,) and the variance (1,) along rows; NaN where it is not determined."""
    before, shift, variance = given.before, np.array([float(given.start), 0.0]), np.nan
    for _ in range(FIT_ROUNDS):
        warped = _warp(given.after, shift)
        slopes = np.gradient(0.5 * (before + warped))
        both = np.isfinite(slopes[0]) & np.isfinite(slopes[1]) & np.isfinite(warped - before)
        if both.sum() < FIT_CELLS:
            return _UNKNOWN
        design = np.stack([slopes[0][both], slopes[1][both], np.ones(int(both.sum()))])
        solved = _solve_robustly(design, (warped - before)[both])
        if solved is None:
            return _UNKNOWN
        shift = shift + solved.change[:2]
        if not np.hypot(shift[0] - given.start, shift[1]) <= FIT_REACH:
            return _UNKNOWN
        variance = _estimate_covariance(design, solved.pulls, solved.normal, both, given.side)[0, 0]
        if np.abs(solved.change[:2]).max() < FIT_SETTLED:
            break
    return shift, np.array([variance])


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    """The solution of one robust least-squares problem."""

    change: NDArray[np.float64]
    """(3,) change of the shift along rows and columns, in cells, and of the height."""
    pulls: NDArray[np.float64]
    """(N,) weighted residuals."""
    normal: NDArray[np.float64]
    """(3, 3) normal matrix."""


def _median(values: NDArray[np.float64]) -> float:
    """Return the median of every k-th value."""
    return float(np.median(values[:: -(-len(values) // FIT_SAMPLES)]))


def _solve_robustly(design: NDArray[np.float64], residual: NDArray[np.float64]) -> _Solution | None:
    """Solve robust least squares of design (3, N) on residuals (N,); None if the problem is singular."""
    solved: _Solution | None = None
    left = residual - _median(residual)
    for _ in range(FIT_REWEIGHTINGS):
        reach = FIT_BIWEIGHT * MAD_TO_SIGMA * _median(np.abs(left)) + 1e-9
        weight = np.clip(1 - (left / reach) ** 2, 0, None) ** 2
        normal = (design * weight) @ design.T
        if not np.linalg.cond(normal) <= FIT_CONDITION:
            return None
        change = -cast("NDArray[np.float64]", np.linalg.solve(normal, (design * weight) @ residual))
        left = residual + change @ design
        solved = _Solution(change, weight * left, normal)
    return solved


def _warp(values: NDArray[np.float64], shift: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return values (Ny, Nx) at (i + shift[0], j + shift[1]), interpolated bilinearly; NaN next to unknown cells."""
    for axis in (0, 1):
        whole = int(np.floor(shift[axis]))
        part = shift[axis] - whole
        values = (1 - part) * _shift_cells(values, whole, axis) + part * _shift_cells(values, whole + 1, axis)
    return values


def _shift_cells(values: NDArray[np.float64], cells: int, axis: int) -> NDArray[np.float64]:
    """Return values displaced by whole cells along an axis; NaN from outside."""
    size: int = values.shape[axis]
    places = np.arange(size) + cells
    out = np.take(values, np.clip(places, 0, size - 1), axis=axis)
    lost = (places < 0) | (places >= size)
    if axis == 0:
        out[lost] = np.nan
    else:
        out[:, lost] = np.nan
    return out


def _estimate_covariance(
    design: NDArray[np.float64],
    pulls: NDArray[np.float64],
    normal: NDArray[np.float64],
    cells: NDArray[np.bool_],
    side: int,
) -> NDArray[np.float64]:
    """Return the covariance (3, 3) of the estimate from the score of each block of cells."""
    row, column = np.nonzero(cells)
    block = (row // side) * (cells.shape[1] // side + 1) + column // side
    sums = np.stack([np.bincount(block, part * pulls) for part in design])
    inverse = np.linalg.inv(normal)
    return inverse @ (sums @ sums.T) @ inverse
