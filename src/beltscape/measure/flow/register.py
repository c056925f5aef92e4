"""How far the load moved between two frames, from its own relief.

The projected pattern stands still while the material passes below it, so images cannot tell the motion; the
material's shape can. A masked normalised correlation (Padfield, IEEE Trans. Image Process. 21(5), 2012,
doi:10.1109/TIP.2011.2181402) over all shifts along y finds the shift to a cell, robust least squares on the
relief's slopes refines it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from beltscape.measure.flow.relief import Relief

_LEAST_SCORE = 0.45
_CLEARLY = 0.15
"""By so much the best correlation must exceed that of any other shift."""
_NEXT_MM = 25.0
"""A shift so near to the best is no other shift."""
_BLOCK_MM = 30.0
"""Errors are taken as independent from block to block of this size."""
_ROUNDS = 4
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
    return _refined(before, after, int(shifts[peak]), float(score[peak]))


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


def _refined(before: Relief, after: Relief, shift: int, score: float) -> Shift | None:
    """Robust least squares (Tukey) on the slopes of both reliefs about a whole-cell shift, warped anew each round.

    σ from blocks of the residuals' pull (a sandwich estimate): errors of neighbouring cells go together.
    """
    rows = before.load.shape[0]
    own = slice(max(0, -shift), min(rows, rows - shift))
    its = slice(own.start + shift, own.stop + shift)
    a, b = before.bump_mm[own], after.bump_mm[its]
    both = np.asarray(ndimage.binary_erosion(before.load[own] & after.load[its], np.ones((5, 5))), bool)
    if both.sum() < _LEAST_CELLS:
        return None
    step, normal = np.zeros(2), np.eye(3)
    design, pulls = np.empty((3, 0)), np.empty(0)
    for _ in range(_ROUNDS):
        warped = ndimage.shift(b, -step, order=3, mode="nearest")
        slopes = [np.gradient(0.5 * (a + warped), axis=axis)[both] for axis in (0, 1)]
        design = np.stack([*slopes, np.ones(len(slopes[0]))])
        residual = (warped - a)[both]
        left = residual - np.median(residual)
        weight = np.clip(1 - (left / (4.7 * 1.4826 * np.median(np.abs(left)) + 1e-9)) ** 2, 0, None) ** 2
        normal = (design * weight) @ design.T
        if np.linalg.cond(normal) > 1e12:
            return None
        change = -np.linalg.solve(normal, (design * weight) @ residual)
        step, pulls = step + change[:2], weight * (residual + change @ design)
        if np.abs(step).max() > _FARTHEST_CELLS:
            return None
    covariance = _sandwich(design, pulls, normal, both, max(1, round(_BLOCK_MM / before.cell_mm)))
    cell = before.cell_mm
    sigma = cell * float(np.hypot(np.sqrt(covariance[0, 0]), _LEAST_SIGMA_CELLS))
    return Shift((shift + float(step[0])) * cell, sigma, float(step[1]) * cell, score)


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
