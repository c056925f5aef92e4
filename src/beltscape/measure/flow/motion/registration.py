"""How far the load moved between two frames, from its own relief.

The projected pattern stands still while the material passes below it, so images cannot tell the motion; the
material's shape can. A masked normalised correlation (Padfield, IEEE Trans. Image Process. 21(5), 2012,
doi:10.1109/TIP.2011.2181402) over all shifts along y finds the shift to a cell, robust least squares on the
heights refines it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from beltscape.measure.flow.motion.high_pass import Relief

_LEAST_SCORE = 0.45
_CLEARLY = 0.15
"""By so much the best correlation must exceed that of any other shift."""
_NEXT_MM = 25.0
"""A shift so near to the best is no other shift."""
_BLOCK_MM = 30.0
"""Errors are taken as independent from block to block of this size."""
_ROUNDS = 8
_SETTLED_CELLS = 1e-4
_WORST_CONDITION = 1e12
_LEAST_CELLS = 100
_FARTHEST_CELLS = 3.0
_LEAST_SIGMA_CELLS = 0.01


@dataclass(frozen=True, slots=True)
class Shift:
    """Motion of the load between two frames, in the belt frame."""

    along_mm: float
    """Towards +y."""
    sigma_mm: float
    """One standard deviation of it."""
    across_mm: float
    """Towards +x."""
    score: float
    """Correlation of the two reliefs, 0..1."""
    clear: bool = True
    """Whether no other shift fits nearly as well; else it was selected by the expected motion."""


def register(
    before: Relief, after: Relief, *, least_overlap: float, near_mm: float | None = None
) -> Shift | None:
    """Motion from one frame's load to another's on the same grid; None where the material does not tell.

    ``least_overlap`` is the share of the grid's rows that both must show. ``near_mm``, where the motion is about
    known, settles which of several alike shifts is the one; a clear one elsewhere goes before it.
    """
    if not (before.telling and after.telling):
        return None
    shifts, score = correlation_along(before, after, least_overlap)
    peak = _peak(shifts * before.cell_mm, score, near_mm)
    if peak is None:
        return None
    clear = _peak(shifts * before.cell_mm, score, None) is not None
    return _refined(before, after, int(shifts[peak]), float(score[peak]), clear)


def correlation_along(
    before: Relief, after: Relief, least_overlap: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Whole-cell shifts along y and the masked normalised correlation at each; -1 where too little is in common."""
    rows, columns = before.load.shape
    reach = int(rows * (1 - least_overlap))
    size = fft.next_fast_len(rows + reach, real=True)

    def spectra(of: Relief) -> list[NDArray[np.complex128]]:
        parts = (of.load.astype(np.float64), of.bump_mm, of.bump_mm**2)
        return [np.asarray(fft.rfft(part, size, axis=0)) for part in parts]

    one, two = spectra(before), spectra(after)

    def summed(i: int, j: int) -> NDArray[np.float64]:
        """Σ over cells of before_i(y) · after_j(y + shift), for all shifts."""
        return np.asarray(fft.irfft((one[i].conj() * two[j]).sum(axis=1), size))

    number = np.maximum(np.rint(summed(0, 0)), 0)
    shifts = np.arange(-reach, reach + 1)
    number, a, b, aa, bb, ab = (
        part[shifts]
        for part in (number, summed(1, 0), summed(0, 1), summed(2, 0), summed(0, 2), summed(1, 1))
    )
    safe = np.maximum(number, 1)
    spread = np.maximum(aa - a * a / safe, 0) * np.maximum(bb - b * b / safe, 0)
    enough = number >= 0.004 * rows * columns
    with np.errstate(invalid="ignore", divide="ignore"):
        score = (ab - a * b / safe) / np.sqrt(spread)
    return shifts, np.where(enough & (spread > 0), score, -1.0)


def _peak(shifts_mm: NDArray[np.float64], score: NDArray[np.float64], near_mm: float | None) -> int | None:
    """Index of the shift that is beyond doubt, or of the one near to what was expected."""
    best = int(np.argmax(score))
    if score[best] < _LEAST_SCORE:
        return None
    others = score[np.abs(shifts_mm - shifts_mm[best]) > _NEXT_MM]
    if not others.size or score[best] - others.max() >= _CLEARLY:
        return best
    if near_mm is None:
        return None
    near = np.abs(shifts_mm - near_mm) <= max(0.1 * abs(near_mm), 0.5 * _NEXT_MM)
    if not near.any():
        return None
    local = int(np.argmax(np.where(near, score, -1.0)))
    return local if score[local] >= max(_LEAST_SCORE, score[best] - _CLEARLY) else None


def _refined(before: Relief, after: Relief, shift: int, score: float, clear: bool) -> Shift | None:
    """Robust least squares (Tukey) on the slopes of the heights themselves, warped anew each round.

    Not on the bumps: what hides beside a rock changes from place to place, and with it the mean about each cell. σ
    from blocks of the residuals' pull (a sandwich estimate), for errors of neighbouring cells go together.
    """
    a, step = before.height_mm, np.array([float(shift), 0.0])
    cell, covariance = before.cell_mm, np.eye(3)
    for _ in range(_ROUNDS):
        warped = _warped(after.height_mm, step)
        slopes = np.gradient(0.5 * (a + warped))
        both = np.isfinite(slopes[0]) & np.isfinite(slopes[1]) & np.isfinite(warped - a)
        if both.sum() < _LEAST_CELLS:
            return None
        design = np.stack([slopes[0][both], slopes[1][both], np.ones(int(both.sum()))])
        solved = _solved(design, (warped - a)[both])
        if solved is None:
            return None
        step = step + solved.change[:2]
        if np.hypot(step[0] - shift, step[1]) > _FARTHEST_CELLS:
            return None
        covariance = _sandwich(design, solved.pulls, solved.normal, both, max(1, round(_BLOCK_MM / cell)))
        if np.abs(solved.change[:2]).max() < _SETTLED_CELLS:
            break
    sigma = cell * float(np.hypot(np.sqrt(covariance[0, 0]), _LEAST_SIGMA_CELLS))
    return Shift(float(step[0]) * cell, sigma, float(step[1]) * cell, score, clear)


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    """One round of robust least squares."""

    change: NDArray[np.float64]
    """(3,) of the motion along and across, in cells, and of the height, mm."""
    pulls: NDArray[np.float64]
    """(N,) weighted residuals."""
    normal: NDArray[np.float64]
    """(3, 3) normal matrix."""


def _solved(design: NDArray[np.float64], residual: NDArray[np.float64]) -> _Solved | None:
    """Robust least squares of design (3, N) on residuals (N,), mm; None if they do not determine the change."""
    solved: _Solved | None = None
    left = residual - np.median(residual)
    for _ in range(3):
        reach = 4.7 * 1.4826 * float(np.median(np.abs(left))) + 1e-9
        weight = np.clip(1 - (left / reach) ** 2, 0, None) ** 2
        normal = (design * weight) @ design.T
        if np.linalg.cond(normal) > _WORST_CONDITION:
            return None
        change = -np.linalg.solve(normal, (design * weight) @ residual)
        left = residual + change @ design
        solved = _Solved(change, weight * left, normal)
    return solved


def _warped(values: NDArray[np.float64], step: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values (Ny, Nx) at (i + step[0], j + step[1]), linear between cells; NaN where one of them is not known."""
    for axis in (0, 1):
        whole = int(np.floor(step[axis]))
        part = step[axis] - whole
        values = (1 - part) * _moved(values, whole, axis) + part * _moved(values, whole + 1, axis)
    return values


def _moved(values: NDArray[np.float64], cells: int, axis: int) -> NDArray[np.float64]:
    """Values of the cells so far on; NaN from outside."""
    size = values.shape[axis]
    places = np.arange(size) + cells
    out = np.take(values, np.clip(places, 0, size - 1), axis=axis)
    lost = (places < 0) | (places >= size)
    if axis == 0:
        out[lost] = np.nan
    else:
        out[:, lost] = np.nan
    return out


def _sandwich(
    design: NDArray[np.float64],
    pulls: NDArray[np.float64],
    normal: NDArray[np.float64],
    cells: NDArray[np.bool_],
    side: int,
) -> NDArray[np.float64]:
    """(3, 3) covariance of the estimate from what the residuals of each block of cells pull at it."""
    row, column = np.nonzero(cells)
    block = (row // side) * (cells.shape[1] // side + 1) + column // side
    sums = np.stack([np.bincount(block, part * pulls) for part in design])
    inverse = np.linalg.inv(normal)
    return inverse @ (sums @ sums.T) @ inverse
