"""The rigid motion of the bare belt since it was learned, from the cells of one depth map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from beltscape.core.empty_belt import Belt
from beltscape.core.statistics import MAD_TO_SIGMA, compute_median, compute_quantile
from beltscape.health.belt.cells import BeltCells

_TERMS = 5
"""Offset, tilt across, tilt along, lateral shift, yaw."""
_LEAST_CELLS = 12
"""Fewer bare cells do not show the belt; a strip of one cell along the view has about 25."""
_ROUGH = 3.0
"""A cell that scatters more than this multiple of the learned belt's noise, or of this frame's smooth cells, is not
bare belt."""
_ROUGHEST = 10.0
"""The limit by this frame's smooth cells is at most this multiple of the learned belt's noise."""
_SMOOTH_RANK = 0.2
"""Rank of the scatter of a frame's smooth cells."""
_PIXEL_SHARE = 0.03
"""Least limit of the scatter and least tolerance, in pixels on the belt."""
_HYPOTHESES = 600
"""Motions through three and through four cells that are tried; with a fifth of the smooth cells bare, three of them
show the belt once in 125 times."""
_LEAST_DETERMINANT = 0.05
"""Cells nearly on one line determine no motion."""
_BELOW_COST = 5.0
"""Cells below a plane count against it this many times: material lies on the belt, not below it."""
_BLOCK = 64
"""Motions that are compared at once: their differences stay in the processor's cache, three times as fast as all."""
_TOLERANCE_SIGMAS = 5.0
"""A cell belongs to a plane within this many of its σ: of 3000 bare cells none is lost by chance."""
_LEAST_PRIOR_MM = 0.05
"""Least standard deviation, at the belt's edges, of what a bare strip does not determine. A larger shift of the
visible strips makes a larger tilt plausible: then their root mean square is taken."""
_SECOND_ORDER = 0.015
"""Error of the mean, as a share of the largest rise, since a tilt is taken as small: 0.07 of 6 mm at one degree."""
_REPEATABILITY_PX = 0.01
"""Standard deviation of the mean height between frames, in pixels on the belt; on eight simulated captures of four
rigs the means repeat to 0.002 pixels."""
_SIZE_EDGE = 4.0
"""Where image sizes differ, a rise at the edges by tilt or lateral shift is uncertain by this multiple of the mean's
σ: 0.26 px against 0.04 px at 612 and 306 px."""


@dataclass(frozen=True, slots=True, eq=False)
class ZeroShift:
    """Motion of the bare belt's surface against the learned one; NaN where no bare belt is visible."""

    offset_mm: float
    """Mean rise over the belt's width and view."""
    sigma_mm: float
    """One standard deviation of it."""
    common_mm: float
    """Part of ``sigma_mm`` that does not average out over frames."""
    motion_mm: NDArray[np.float64]
    """(5,) even rise; rise of the right edge by a tilt across; of the far end by a tilt along; lateral shift; lateral
    shift of the far end by a yaw."""
    covariance_mm2: NDArray[np.float64]
    """(5, 5) covariance of ``motion_mm``."""
    bare: NDArray[np.bool_]
    """(N,) which of the cells show the bare belt."""
    over_mm: NDArray[np.float64]
    """(N,) heights of the cells over the belt as it lies now."""
    sides: tuple[int, int]
    """Numbers of bare cells in the left and in the right third of the belt."""

    @property
    def is_measured(self) -> bool:
        """Return whether bare belt is visible."""
        return bool(np.isfinite(self.offset_mm))

    @property
    def tilts_mm(self) -> NDArray[np.float64]:
        """Return (2, 2): the tilts across and along as a rise from end to end, and their σ."""
        sigma = np.sqrt(np.diag(self.covariance_mm2))
        return 2 * np.stack([self.motion_mm[1:3], sigma[1:3]], axis=-1)


def estimate_zero_shift(cells: BeltCells, belt: Belt, pixel_mm: float, search_mm: float) -> ZeroShift:
    """Return the motion of the lowest smooth surface with the belt's own profile.

    Cells with material scatter more than bare belt, or lie above the surface that most smooth cells have in common;
    neither moves the result. A smooth layer over the whole view cannot be told from a risen belt. Surfaces further
    than ``search_mm`` from the learned belt are not searched.
    """
    smooth = _find_smooth(cells, belt, pixel_mm) & (np.abs(cells.height_mm) <= search_mm)
    terms, over_view = _terms(cells, belt)
    tolerance = np.maximum(_TOLERANCE_SIGMAS * cells.sigma_mm, _TOLERANCE_SIGMAS * _PIXEL_SHARE * pixel_mm)
    bare = _find_lowest_surface(cells.height_mm, terms, smooth, tolerance, search_mm)
    if bare is None:
        return make_unmeasured_shift(len(cells))
    motion, covariance = np.zeros(_TERMS), np.eye(_TERMS)
    for _ in range(6):
        motion, covariance = _fit(cells.height_mm[bare], cells.sigma_mm[bare], terms[bare])
        left = cells.height_mm - terms @ motion
        scatter = MAD_TO_SIGMA * compute_median(np.abs(left[bare]))
        grown = smooth & (np.abs(left) <= np.maximum(np.minimum(tolerance, 5 * scatter), 4 * cells.sigma_mm))
        if grown.sum() < _LEAST_CELLS:
            return make_unmeasured_shift(len(cells))
        if np.array_equal(grown, bare):
            break
        bare = grown
    largest = float(np.abs(motion[1:]).max())
    other_size = cells.other_size_mm
    common = float(
        np.sqrt(
            belt.drift_mm**2
            + (_REPEATABILITY_PX * pixel_mm) ** 2
            + (_SECOND_ORDER * largest) ** 2
            + other_size**2
        )
    )
    covariance = covariance + np.diag(np.r_[0.0, [(_SIZE_EDGE * other_size) ** 2] * (_TERMS - 1)])
    third = cells.shape[1] / 3
    return ZeroShift(
        float(over_view @ motion),
        float(np.sqrt(over_view @ covariance @ over_view + common**2)),
        common,
        motion,
        covariance,
        bare,
        cells.height_mm - terms @ motion,
        (int((bare & (cells.column < third)).sum()), int((bare & (cells.column >= 2 * third)).sum())),
    )


def make_unmeasured_shift(number: int) -> ZeroShift:
    """Return the shift where ``number`` cells show no bare belt."""
    nan = float("nan")
    return ZeroShift(
        nan,
        nan,
        nan,
        np.full(_TERMS, np.nan),
        np.full((_TERMS, _TERMS), np.nan),
        np.zeros(number, bool),
        np.full(number, np.nan),
        (0, 0),
    )


def _find_smooth(cells: BeltCells, belt: Belt, pixel_mm: float) -> NDArray[np.bool_]:
    """Return which cells (N,) are as smooth as the learned belt."""
    if not len(cells):
        return np.zeros(0, bool)
    usual = compute_quantile(cells.scatter_mm, _SMOOTH_RANK)
    limit = max(_ROUGH * belt.noise_mm, min(_ROUGH * usual, _ROUGHEST * belt.noise_mm))
    return cells.scatter_mm <= max(limit, _PIXEL_SHARE * pixel_mm)


def _terms(cells: BeltCells, belt: Belt) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the rise (N, 5) of each cell for 1 mm of each term, and their means (5,) over the belt in view."""
    low, high = belt.across_mm
    half_x, half_y = (high - low) / 2, max(cells.shape[0] * cells.side_mm / 2, 1.0)
    x = (cells.x_mm - (low + high) / 2) / half_x
    y = (cells.y_mm - cells.y_middle_mm) / half_y
    step = cells.side_mm / 4
    climb = (belt.height_mm(cells.x_mm - step) - belt.height_mm(cells.x_mm + step)) / (2 * step)
    terms = np.stack([np.ones_like(x), x, y, climb, climb * y], axis=-1)
    # tilts about the middle of the view vanish in the mean; a lateral shift lifts the belt's ends differently
    lateral = float(belt.height_mm(np.array([low]))[0] - belt.height_mm(np.array([high]))[0]) / (high - low)
    return terms, np.array([1.0, 0.0, 0.0, lateral, 0.0])


def _find_lowest_surface(
    height_mm: NDArray[np.float64],
    terms: NDArray[np.float64],
    smooth: NDArray[np.bool_],
    tolerance_mm: NDArray[np.float64],
    search_mm: float,
) -> NDArray[np.bool_] | None:
    """Return the smooth cells (N,) on the motion that has most of them and few below it; None without one."""
    own = np.flatnonzero(smooth)
    if len(own) < _LEAST_CELLS:
        return None
    level = np.zeros((len(own[:: max(1, len(own) // 100)]), _TERMS))
    level[:, 0] = height_mm[own[:: max(1, len(own) // 100)]]
    motions = np.concatenate([level, *(_solve_motions(height_mm[own], terms[own], n) for n in (3, 4))])
    motions = motions[np.abs(motions).sum(axis=1) <= search_mm]
    if not len(motions):
        return None
    blocks = np.array_split(motions, -(-len(motions) // _BLOCK))
    own_cells = height_mm[own], terms[own], tolerance_mm[own]
    best = int(np.argmax(np.concatenate([_score_motions(block, *own_cells) for block in blocks])))
    near = own[np.abs(height_mm[own] - terms[own] @ motions[best]) <= tolerance_mm[own]]
    if len(near) < _LEAST_CELLS:
        return None
    chosen = np.zeros(len(height_mm), bool)
    chosen[near] = True
    return chosen


def _score_motions(
    motions: NDArray[np.float64],
    height_mm: NDArray[np.float64],
    terms: NDArray[np.float64],
    tolerance_mm: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return for each motion (K, 5) the number of cells on it, less the cost of those below it.

    A cell counts less, the further it is from the surface (Torr and Zisserman, "MLESAC", 2000): a tilted surface
    between the belt and a splice or cake is near many cells of both, but on none.
    """
    off = (height_mm - motions @ terms.T) / tolerance_mm
    below = np.count_nonzero(off < -2, axis=1)
    near = np.maximum(1 - np.square(off, out=off), 0, out=off).sum(axis=1)
    return near - _BELOW_COST * below


def _solve_motions(
    height_mm: NDArray[np.float64], terms: NDArray[np.float64], number: int
) -> NDArray[np.float64]:
    """Return motions (K, 5) of the first ``number`` terms, each through as many cells drawn at random."""
    picks = np.random.default_rng(number).integers(0, len(height_mm), (_HYPOTHESES, number))
    corners = terms[picks][..., :number]
    regular = np.abs(np.linalg.det(corners)) > _LEAST_DETERMINANT
    motions = np.zeros((int(regular.sum()), _TERMS))
    right = height_mm[picks[regular]][..., None]
    motions[:, :number] = cast("NDArray[np.float64]", np.linalg.solve(corners[regular], right))[..., 0]
    return motions


def _fit(
    height_mm: NDArray[np.float64], sigma_mm: NDArray[np.float64], terms: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the motion (5,) and its covariance; tilts and shifts that the cells do not determine stay small."""
    prior = max(_LEAST_PRIOR_MM, float(np.sqrt(np.mean(height_mm**2))))
    weight = 1 / sigma_mm**2
    normal = (terms * weight[:, None]).T @ terms + np.diag([0.0, *([prior**-2] * (_TERMS - 1))])
    motion = cast("NDArray[np.float64]", np.linalg.solve(normal, terms.T @ (weight * height_mm)))
    left = (height_mm - terms @ motion) / sigma_mm
    excess = max(1.0, float(np.sum(left**2)) / max(len(left) - _TERMS, 1))
    return motion, excess * cast("NDArray[np.float64]", np.linalg.inv(normal))
