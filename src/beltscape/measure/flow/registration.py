"""Registration of the load between two frames by its heights.

The projected pattern is static while the material passes below it, so the motion follows from the material's shape
and not from images. A masked normalised correlation (Padfield, IEEE Trans. Image Process. 21(5), 2012,
doi:10.1109/TIP.2011.2181402) over all shifts along y finds the shift to a cell, robust least squares on the
heights refines it.

Consecutive frames are registered by the high-pass heights of their loads.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from beltscape.core.statistics import MAD_TO_SIGMA, compute_median, drop_nan
from beltscape.kernels import load_on_processor

Values = NDArray[np.floating]

_SMOOTH_MM = 20.0
"""Gaussian σ of the low-pass that is subtracted: broader hills do not determine a position sharply."""
_LEAST_MM = 3.0
"""Lower loads are excluded: errors of the empty belt stand still and would bias the registration to no motion."""
_LEAST_SHARE = 0.005
"""With a smaller share of loaded cells there is nothing to register."""
_TALLEST = 4.0
"""Heights are clipped to this multiple of their spread, so that single rocks do not dominate."""


@dataclass(frozen=True, slots=True, eq=False)
class HighPassHeights:
    """Heights and high-pass heights of a load, on a static grid (rows along y ascending, columns along x)."""

    height_mm: NDArray[np.float64]
    """(Ny, Nx) height over the empty belt; NaN where there is no load."""
    high_pass_mm: NDArray[np.float64]
    """(Ny, Nx) height over the neighbourhood's mean, clipped; 0 where there is no load."""
    load: NDArray[np.bool_]
    """(Ny, Nx) whether a load was measured."""
    cell_mm: float
    """Edge of a cell."""
    surface_mm: NDArray[np.float32]
    """(Ny, Nx) height over the empty belt wherever it was measured; NaN elsewhere."""

    def leave_out(self, cells: NDArray[np.bool_], noise_mm: float) -> HighPassHeights:
        """Return the high-pass without the load of some cells (Ny, Nx)."""
        without = compute_high_pass(np.where(cells, np.nan, self.surface_mm), self.cell_mm, noise_mm)
        return replace(without, surface_mm=self.surface_mm)

    @property
    def has_load(self) -> bool:
        """Return whether there is enough load for registration."""
        return float(self.load.mean()) >= _LEAST_SHARE


def compute_high_pass(height_mm: NDArray[np.float64], cell_mm: float, noise_mm: float) -> HighPassHeights:
    """Return the high-pass of a load (Ny, Nx), NaN where not measured; ``noise_mm`` is the empty belt's noise."""
    load = np.nan_to_num(height_mm, nan=-np.inf) > max(_LEAST_MM, 6 * noise_mm)
    # isolated cells are flying points, not load
    load &= cv2.blur(load.astype(np.float32), (5, 5), borderType=cv2.BORDER_REFLECT) > 0.5
    value = np.where(load, height_mm, 0.0)
    weight = _smooth(load, cell_mm)
    high_pass = value - _smooth(value, cell_mm) / np.maximum(weight, np.float32(1e-9))
    high_pass[~load] = 0.0
    spread = float(np.sqrt(np.square(high_pass).sum() / max(np.count_nonzero(load), 1)))
    high_pass = np.clip(high_pass, -_TALLEST * spread, _TALLEST * spread, out=high_pass)
    return HighPassHeights(
        np.where(load, height_mm, np.nan), high_pass, load, cell_mm, height_mm.astype(np.float32)
    )


def _smooth(values: NDArray[np.generic], cell_mm: float) -> NDArray[np.float32]:
    """Return values (Ny, Nx) under a Gaussian of `_SMOOTH_MM`, cut off at 4 σ, with the image mirrored at its rims.

    In float32 it takes a sixth of the time of SciPy's; heights of 300 mm differ by 0.0001 mm.
    """
    sigma = _SMOOTH_MM / cell_mm
    side = 2 * int(4 * sigma + 0.5) + 1
    return cv2.GaussianBlur(values.astype(np.float32), (side, side), sigma, borderType=cv2.BORDER_REFLECT)


def compute_free_mm(frame: HighPassHeights, direction: int) -> float:
    """Return the length without load at the end of the view at which the belt leaves it.

    ``direction`` of travel is +1 towards +y, -1 towards -y.
    """
    rows = np.flatnonzero(frame.load.any(axis=1))
    count = len(frame.load)
    if not len(rows):
        return count * frame.cell_mm
    return float((count - 1 - rows[-1] if direction > 0 else rows[0]) * frame.cell_mm)


_LEAST_SCORE = 0.45
"""Least correlation of the best shift. Chosen; `plausibility` recognises other material that reaches it by chance."""
CLEAR_MARGIN = 0.15
"""Margin by which the best correlation must exceed that of any other shift. Chosen."""
NEXT_MM = 25.0
"""Shifts nearer than this to the best one belong to the same peak: about the size of the high-pass, 20 mm."""
_BLOCK_MM = 30.0
"""Errors of different blocks of this size count as independent: beyond the windows of matching on the belt."""
_LEAST_COMMON = 0.004
"""Least share of the grid that is load in both frames, for a correlation. Chosen."""
_NEAR_SHARE = 0.1
"""Relative difference of a shift from the predicted motion up to which they agree. Chosen."""
_LEAST_SIGMA_CELLS = 0.01
"""Lower limit of σ: the interpolation between cells."""
_LEAST_COMMON_STRUCTURE = 0.7
"""Least share of the slopes along the belt that two frames have in common. Chosen: on six rendered heaps it is 0.97
to 1; on 290 pairs of even ridges with noise at most 0.45, and 0.64 where the noise is correlated over 40 mm."""
_CHANCE_STRUCTURE = 3.0
"""Noise reaches a common structure of this over the root of the number of blocks at its best shift: on pairs of even
ridges, with noise that is correlated over up to 40 mm, 0.67 on 20 blocks and 0.49 on 100."""
_OUTLIER_SIGMAS = 4.7
"""Cells that differ by more robust σ between the frames are steps; as the end of the fit's weights."""
_LOCKING_CELLS = 0.01
"""σ of the bias of interpolation, the same for equal steps: 0.009 cells over nine steps at two resolutions."""


@dataclass(frozen=True, slots=True)
class Shift:
    """Motion of the load between two frames, in the belt frame."""

    along_mm: float
    """Motion towards +y."""
    sigma_mm: float
    """One standard deviation of ``along_mm``."""
    across_mm: float
    """Motion towards +x."""
    score: float
    """Correlation of the two frames' high-pass heights, 0..1."""
    clear: bool = True
    """Whether no other shift fits nearly as well; else it was selected by the predicted motion."""
    support: float = 1.0
    """Share of the view's cells on which both frames have a load at this shift, 0..1."""
    common_mm: float = 0.0
    """σ of the part of the error that equal steps of the belt have in common; included in ``sigma_mm``."""


@dataclass(frozen=True, slots=True)
class PredictedMatch:
    """The similarity of two frames at the predicted motion."""

    score: float
    """Correlation of their high-pass heights; NaN without a common load."""
    support: float
    """Share of the view's cells on which both frames have a load."""


def register(
    before: HighPassHeights, after: HighPassHeights, *, least_overlap: float, near_mm: float | None = None
) -> Shift | None:
    """Register the loads of two frames on the same grid; None where the material does not determine the motion.

    ``least_overlap`` is the share of the grid's rows that both frames must contain. The predicted motion ``near_mm``,
    where given, selects one of several similar shifts; an unambiguous shift elsewhere takes precedence.
    """
    if not (before.has_load and after.has_load):
        return None
    shifts, score, support = correlate_along(before, after, least_overlap)
    shifts_mm = cast("NDArray[np.float64]", shifts * before.cell_mm)
    peak = _select_peak(shifts_mm, score, near_mm)
    if peak is None:
        return None
    clear = _select_peak(shifts_mm, score, None) is not None
    shift = _refine(before, after, int(shifts[peak]), float(score[peak]), clear)
    return None if shift is None else replace(shift, support=float(support[peak]))


def match_prediction(
    before: HighPassHeights, after: HighPassHeights, *, least_overlap: float, near_mm: float
) -> PredictedMatch:
    """Return how well two frames match at a predicted motion along y."""
    shifts, score, support = correlate_along(before, after, least_overlap)
    near = (np.abs(shifts * before.cell_mm - near_mm) <= _compute_tolerance_mm(near_mm)) & (score > -1)
    if not near.any():
        return PredictedMatch(float("nan"), 0.0)
    best = int(np.argmax(np.where(near, score, -1.0)))
    return PredictedMatch(float(score[best]), float(support[best]))


def correlate_along(
    before: HighPassHeights, after: HighPassHeights, least_overlap: float
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the shifts along y in cells, the masked normalised correlation (-1 without enough overlap), the support.

    The support is the share of the view's cells on which both frames have a load.
    """
    rows, columns = before.load.shape
    reach = int(rows * (1 - least_overlap))
    size = fft.next_fast_len(rows + reach, real=True)

    one, two = _compute_spectra(before, size), _compute_spectra(after, size)

    def correlate(i: int, j: int) -> NDArray[np.float64]:
        """Return Σ over cells of before_i(y) · after_j(y + shift), for all shifts."""
        spectrum = cast("NDArray[np.complex128]", (one[i].conj() * two[j]).sum(axis=1))
        return np.asarray(fft.irfft(spectrum, size))

    number = np.maximum(np.rint(correlate(0, 0)), 0)
    shifts = np.arange(-reach, reach + 1)
    number, a, b, aa, bb, ab = (
        part[shifts]
        for part in (
            number,
            correlate(1, 0),
            correlate(0, 1),
            correlate(2, 0),
            correlate(0, 2),
            correlate(1, 1),
        )
    )
    score = normalise_correlation(number, (a, b), (aa, bb), ab, _LEAST_COMMON * rows * columns)
    return shifts, np.asarray(score, np.float64), number / (rows * columns)


@lru_cache(maxsize=4)
def _compute_spectra(heights: HighPassHeights, size: int) -> tuple[NDArray[np.complex128], ...]:
    """Return the spectra along columns, padded to ``size``, of the load, the high-pass heights and their squares.

    A frame is compared with the one before and with the one after it.
    """
    parts = heights.load.astype(np.float64), heights.high_pass_mm, heights.high_pass_mm**2
    return tuple(np.asarray(fft.rfft(part, size, axis=0)) for part in parts)


def normalise_correlation(
    number: Values,
    sums: tuple[Values, Values],
    squares: tuple[Values, Values],
    products: Values,
    least: float,
) -> Values:
    """Return the masked normalised correlation of two fields at some shifts; -1 where they share too few cells.

    All arrays hold sums over the ``number`` of cells that the fields share at a shift: of each one's values, of their
    squares, and of the products. ``least`` is the least number of cells. Padfield 2012, Eq. 11.
    """
    (a, b), (aa, bb) = sums, squares
    safe = np.maximum(number, 1)
    spread = np.maximum(aa - a * a / safe, 0) * np.maximum(bb - b * b / safe, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        score = (products - a * b / safe) / np.sqrt(spread)
    return np.asarray(np.where((number >= least) & (spread > 0), score, -1.0))


def _select_peak(
    shifts_mm: NDArray[np.float64], score: NDArray[np.float64], near_mm: float | None
) -> int | None:
    """Return the index of the unambiguous shift, else of the best one near the predicted motion."""
    best = int(np.argmax(score))
    if score[best] < _LEAST_SCORE:
        return None
    others = score[np.abs(shifts_mm - shifts_mm[best]) > NEXT_MM]
    if not others.size or score[best] - others.max() >= CLEAR_MARGIN:
        return best
    if near_mm is None:
        return None
    near = np.abs(shifts_mm - near_mm) <= _compute_tolerance_mm(near_mm)
    if not near.any():
        return None
    local = int(np.argmax(np.where(near, score, -1.0)))
    return local if score[local] >= max(_LEAST_SCORE, score[best] - CLEAR_MARGIN) else None


def _compute_tolerance_mm(near_mm: float) -> float:
    """Return the distance from a predicted motion within which a shift agrees with it."""
    return max(_NEAR_SHARE * abs(near_mm), 0.5 * NEXT_MM)


def _refine(
    before: HighPassHeights, after: HighPassHeights, shift: int, score: float, clear: bool
) -> Shift | None:
    """Refine a shift by robust least squares on the heights (kernels/least_squares.py).

    The high-pass heights are not used, because occlusion beside rocks changes with their position, and with it the
    mean around each cell. The least squares take the noise of the slopes for structure; only what both frames show of
    it determines the shift, so σ is larger by its inverse share. None where the slopes are noise.
    """
    cell = before.cell_mm
    side = max(1, round(_BLOCK_MM / cell))
    fitted = load_on_processor().fit_shift(before.height_mm, after.height_mm, shift, side=side)
    along, across = (float(part) * cell for part in fitted.shift)
    if not np.isfinite(along):
        return None
    common = _compute_common_structure(before.height_mm, after.height_mm, fitted.shift, side)
    if common is None:
        return None
    sigma = cell * float(np.hypot(np.sqrt(fitted.variance[0]) / common, _LEAST_SIGMA_CELLS))
    return Shift(along, sigma, across, score, clear, common_mm=_LOCKING_CELLS * cell)


def _compute_common_structure(
    before: NDArray[np.float64], after: NDArray[np.float64], shift: NDArray[np.float64], side: int
) -> float | None:
    """Return the share of the slopes along rows that two fields (Ny, Nx) have in common at a shift in cells.

    It is Σ g_before g_after over Σ ((g_before + g_after) / 2)², the information that the fit takes for the shift's: 1
    without noise, 0 in the mean for independent noise. Outliers, as of steps, are left out. None where independent
    noise reaches it, too, on so few blocks of ``side`` cells.
    """
    moved = _move_rows(after, float(shift[0]), round(float(shift[1])))
    apart = moved - before
    apart -= compute_median(drop_nan(apart))
    usual = compute_median(drop_nan(np.abs(apart)))
    is_inlier = np.abs(apart) < _OUTLIER_SIGMAS * MAD_TO_SIGMA * usual + 1e-9
    one, two = (np.diff(np.where(is_inlier, field, np.nan), axis=0) for field in (before, moved))
    product, mean = one * two, 0.25 * (one + two) ** 2
    rows, columns = np.nonzero(np.isfinite(product))
    blocks = np.count_nonzero(np.bincount(rows // side * (before.shape[1] // side + 1) + columns // side))
    information = float(np.nansum(mean))
    share = float(np.nansum(product)) / information if information > 0 else 0.0
    least = max(_LEAST_COMMON_STRUCTURE, _CHANCE_STRUCTURE / np.sqrt(max(blocks, 1)))
    return min(share, 1.0) if share >= least else None


def _move_rows(field: NDArray[np.float64], rows: float, columns: int) -> NDArray[np.float64]:
    """Return the field (Ny, Nx) at (i + rows, j + columns), interpolated between rows; NaN where it is unknown."""
    whole = int(np.floor(rows))
    part = rows - whole
    out = np.full(field.shape, np.nan)
    (ny, nx), (low, left) = field.shape, (max(0, -whole), max(0, -columns))
    end, right = min(ny, ny - 1 - whole), min(nx, nx - columns)
    if end > low and right > left:
        there = field[low + whole : end + whole + 1, left + columns : right + columns]
        out[low:end, left:right] = (1 - part) * there[:-1] + part * there[1:]
    return out
