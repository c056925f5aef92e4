"""The references of the kernels of selection: candidates, propagation, and semi-global selection.

Semi-global selection chooses among the candidates that the pixels keep.
"""

from __future__ import annotations

from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Array
from beltscape.kernels.reference.view import (
    bilinear,
    centred_windows,
    is_inside,
    project,
    window_dissimilarity,
)
from beltscape.kernels.selection import (
    CANDIDATES,
    CandidatesInput,
    PhotoConsistencyInput,
    Propagated,
    PropagationInput,
)

NO_CANDIDATE = 1e6
"""The inverse depth of an empty place: far from all others, and exact in single precision."""

STEEPEST_STEP = 1.0
"""Largest step of s between neighbours that their slopes may explain; half and double change the share within 0.25 mm
of a quarter-size heap by 0.04 %."""
PATHS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1))
"""Steps (dx, dy) along the eight paths."""


class Kept(NamedTuple):
    """Candidates, (H, W, K) each."""

    s: Array
    slope_u: Array
    slope_v: Array
    cost: Array

    def rows(self, first: int, end: int) -> Kept:
        """Return the candidates of rows first … end - 1."""
        return Kept(*(field[first:end] for field in self))

    def at(self, y: int, x: slice) -> Kept:
        """Return the candidates of a row's pixels, (n, K) each."""
        return Kept(*(field[y, x] for field in self))


APART = 1.5
"""Candidates farther apart in s are different surfaces. The network of confidence was fitted with this value; half
and double change the measured share of a quarter-size heap by 0.1 %."""


def choose(kept: Kept, small_jump: float, large_jump: float) -> Propagated:
    """Return the candidates with the least sum of cost and mean cost of the eight paths."""
    paths = [_path(kept, dx, dy, small_jump, large_jump) for dx, dy in PATHS]
    totals = kept.cost + np.mean(paths, axis=0)
    best = totals.argmin(axis=2)[..., None]
    s, slope_u, slope_v, cost = (np.take_along_axis(field, best, axis=2)[..., 0] for field in kept)
    apart = np.abs(kept.s - s[..., None]) > APART
    margin = np.minimum(np.where(apart, totals, np.inf).min(axis=2) - totals.min(axis=2), 1)
    none = s == NO_CANDIDATE
    s, cost, margin = (np.where(none, np.nan, field) for field in (s, cost, margin))
    return Propagated(s, slope_u, slope_v, cost, margin)


def _path(kept: Kept, dx: int, dy: int, small_jump: float, large_jump: float) -> Array:
    """Return (H, W, K) the cost of each candidate on the paths of one direction."""
    if dy == 0:  # the same along columns
        turned = Kept(*(field.swapaxes(0, 1) for field in (kept.s, kept.slope_v, kept.slope_u, kept.cost)))
        return _path(turned, 0, dx, small_jump, large_jump).swapaxes(0, 1)
    height, width, _ = kept.s.shape
    brought = np.zeros(kept.s.shape)
    to, from_ = slice(max(dx, 0), width + min(dx, 0)), slice(max(-dx, 0), width - max(dx, 0))
    rows = range(height) if dy > 0 else range(height - 1, -1, -1)
    for y in rows[1:]:
        before, here = kept.at(y - dy, from_), kept.at(y, to)
        toll = before.cost + brought[y - dy, from_]
        toll -= toll.min(axis=1, keepdims=True)
        least = (toll[:, None] + _jump(before, here, dx, dy, small_jump)).min(axis=2)
        brought[y, to] = np.minimum(least, large_jump)
    return brought


def _jump(before: Kept, here: Kept, dx: int, dy: int, small_jump: float) -> Array:
    """Return (n, K, K) costs of the step from each candidate of the pixels before (last axis) to each one here."""
    slope_u = (here.slope_u[:, :, None] + before.slope_u[:, None]) / 2
    slope_v = (here.slope_v[:, :, None] + before.slope_v[:, None]) / 2
    expected = np.clip(slope_u * dx + slope_v * dy, -STEEPEST_STEP, STEEPEST_STEP)
    return small_jump * np.abs(here.s[:, :, None] - before.s[:, None] - expected)


NO_COST = 1e3
"""Cost of an empty place: more than any candidate's, which is at most 1 and eight jumps of at most 100."""
FARTHEST_STEP = 3.0
"""Largest change of s by which a candidate is continued from its pixel along its slopes; half and double change the
share within 0.25 mm of a quarter-size heap by 0.04 %."""
BAND_ROWS = 128
"""Rows of a band, of which each is computed by one thread; native/selection/propagate.hpp has the same."""
HALO_ROWS = 12
"""Rows beyond a band from which its paths begin; from 6 to 24, a heap's depth changes by less than 0.01 %."""


def propagate(given: PropagationInput) -> tuple[NDArray[np.floating], ...]:
    """Return the fields of Propagated, (H, W) each."""
    kept = _select_candidates(given)
    height = given.core.shape[0]
    bands: list[list[NDArray[np.floating]]] = []
    for first in range(0, height, BAND_ROWS):
        end = min(height, first + BAND_ROWS)
        above, below = max(0, first - HALO_ROWS), min(height, end + HALO_ROWS)
        band = choose(kept.rows(above, below), given.costs.small_jump, given.costs.large_jump)
        bands.append([field[first - above : end - above] for field in band])
    return tuple(np.concatenate(parts) for parts in zip(*bands, strict=True))


def _select_candidates(given: PropagationInput) -> Kept:
    """Return the candidates (H, W, K) that the pixels keep."""
    s, slope_u, slope_v = given.surface
    shape = (*s.shape, given.candidates)
    kept = Kept(
        s=np.full(shape, NO_CANDIDATE),
        slope_u=np.repeat(finite_or_zero(slope_u)[..., None], given.candidates, axis=2),
        slope_v=np.repeat(finite_or_zero(slope_v)[..., None], given.candidates, axis=2),
        cost=np.full(shape, NO_COST),
    )
    everywhere = np.ones(s.shape, bool)
    active = everywhere if given.active is None else given.active > 0
    for i, (dx, dy) in enumerate([(0, 0), *given.offsets.tolist()]):
        candidate = shifted_candidate(given, dx, dy)
        allowed = np.isfinite(candidate[0]) & (everywhere if i == 0 else active)
        _keep(kept, (*candidate, dissimilarity(given, candidate[0])), given.costs.separation, allowed)
    return kept


def finite_or_zero(a: NDArray[np.floating]) -> Array:
    """Return the values as float64, 0 for those that are not finite."""
    return np.where(np.isfinite(a), a, 0).astype(np.float64)


def shifted_candidate(given: PropagationInput, dx: int, dy: int) -> tuple[Array, Array, Array]:
    """Return the candidate of an offset and its slopes, (H, W) each."""
    s, slope_u, slope_v = given.surface
    height, width = s.shape
    y, x = cast("NDArray[np.int64]", np.indices(s.shape))
    from_y, from_x = np.clip(y - dy, 0, height - 1), np.clip(x - dx, 0, width - 1)
    slope_u, slope_v = finite_or_zero(slope_u[from_y, from_x]), finite_or_zero(slope_v[from_y, from_x])
    step = np.clip(slope_u * (x - from_x) + slope_v * (y - from_y), -FARTHEST_STEP, FARTHEST_STEP)
    return s[from_y, from_x] + step, slope_u, slope_v


def dissimilarity(given: PropagationInput, s: Array) -> Array:
    """Return (H, W) dissimilarity of the surface s over the views that see each pixel."""
    y, x = cast("NDArray[np.int64]", np.indices(s.shape))
    core = centred_windows(given.core.astype(np.float64))
    each: list[Array] = []
    seen: list[NDArray[np.bool_]] = []
    for image, view, buffer in zip(given.images, given.views, given.buffers, strict=True):
        u, v, inverse_depth = project(view, x, y, s)
        aux = centred_windows(bilinear(image.astype(np.float64), u, v))
        each.append(window_dissimilarity(core, aux, given.costs.floor))
        seen.append(clear(buffer, u, v, inverse_depth + given.costs.tolerance))
    return _agreement(np.array(each), np.array(seen), given.costs.unseen_cost)


def _agreement(each: Array, seen: NDArray[np.bool_], unseen_cost: float) -> Array:
    """Return (H, W) the mean of the visible views' dissimilarities (n, H, W), without the worst of three or more."""
    views, counted = seen.sum(axis=0), np.where(seen, each, 0)
    total, worst = counted.sum(axis=0), counted.max(axis=0)
    without_worst, with_worst = (total - worst) / np.maximum(views - 1, 1), total / np.maximum(views, 1)
    mean = cast("NDArray[np.float64]", np.where(views > 2, without_worst, with_worst))
    return np.where(views > 0, mean, unseen_cost)


def clear(buffer: NDArray[np.floating], u: Array, v: Array, reach: Array) -> NDArray[np.bool_]:
    """Return (H, W) where (u, v) is in the image and the buffer (h, w) at the nearest pixel is at most ``reach``."""
    inside = is_inside(buffer.shape, u, v)
    x, y = (np.floor(np.where(inside, a, 0) + 0.5).astype(int) for a in (u, v))
    return inside & (buffer[y, x] <= np.where(inside, reach, 0))


def _keep(
    kept: Kept, candidate: tuple[Array, Array, Array, Array], separation: float, allowed: NDArray[np.bool_]
) -> None:
    """Insert a candidate (s, slope_u, slope_v, cost), (H, W) each, where it is cheaper than the one it replaces."""
    s, cost = candidate[0], candidate[3]
    near = np.abs(kept.s - s[..., None]) < separation
    place = cast(
        "NDArray[np.int64]", np.where(near.any(axis=2), near.argmax(axis=2), kept.cost.argmax(axis=2))
    )
    there = np.take_along_axis(kept.cost, place[..., None], axis=2)[..., 0]
    y, x = np.nonzero(allowed & (cost < there))
    for field, value in zip(kept, candidate, strict=True):
        field[y, x, place[y, x]] = value[y, x]


STEEPEST = 1.5
"""px of s per px: steeper slopes are continued with this one; half and double change a heap's depth by 0.02 %."""
MOST_UNLIKE = 50.0
"""Bound of a squared difference over its variance (seven σ, squared), and its value where no view sees the point. The
network that ranks candidates was fitted with it; half and double change a quarter-size heap by 0.02 %."""
DIRECTIONS = tuple((dx, dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dx or dy)
"""Steps (dx, dy) to the eight neighbours, in the order of the candidates."""
CROSS = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))
"""Offsets (dx, dy) of the pixel and the four beside it."""


def candidate_surfaces(given: CandidatesInput) -> list[NDArray[np.float32]]:
    """Return the fields of Candidates, (9, N) each."""
    at = given.v.astype(int), given.u.astype(int)
    level, *slopes = (plane.astype(np.float64) for plane in given.surface)
    slopes = [np.clip(finite_or_zero(slope), -STEEPEST, STEEPEST) for slope in slopes]
    own = np.where(np.isfinite(level), 0, np.nan)[at]
    rows = [(level[at] + own, slopes[0][at] + own, slopes[1][at] + own, own)]
    rows += [_directional_candidate(given, (level, *slopes), at, dx, dy) for dx, dy in DIRECTIONS]
    found = [np.stack(parts) for parts in zip(*rows, strict=True)]
    support = _support(found[0], found[3], given.separation)
    return [np.asarray(part, np.float32) for part in (*found, support)]


def _directional_candidate(
    given: CandidatesInput,
    surface: tuple[Array, ...],
    at: tuple[NDArray[np.int_], NDArray[np.int_]],
    dx: int,
    dy: int,
) -> tuple[Array, ...]:
    """Return s, slopes and distance (N,) of the candidate from a direction's first reliable pixel."""
    height, width = given.reliable.shape
    out = [np.full(len(at[0]), np.nan) for _ in range(4)]
    for step in range(1, given.reach + 1):
        y, x = at[0] + step * dy, at[1] + step * dx
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        y, x = np.where(inside, y, 0), np.where(inside, x, 0)
        s, slope_u, slope_v = (plane[y, x] for plane in surface)
        new = inside & (given.reliable[y, x] > 0) & np.isfinite(s) & np.isnan(out[3])
        here = s - slope_u * step * dx - slope_v * step * dy, slope_u, slope_v, np.full(len(s), step)
        out = [np.where(new, value, kept) for value, kept in zip(here, out, strict=True)]
    return tuple(out)


def _support(s: Array, distance: Array, separation: float) -> Array:
    """Return (9, N) the number of others that agree, weighted by their distance; the pixel's own does not count."""
    support = np.zeros_like(s)
    for i in range(CANDIDATES):
        for k in range(1, CANDIDATES):
            if k != i:
                support[i] += np.where(np.abs(s[i] - s[k]) < separation, 1 / (1 + distance[k]), 0)
    return support


def photo_consistency(given: PhotoConsistencyInput) -> tuple[NDArray[np.float32]]:
    """Return the fields of PhotoConsistency (C, N) below each other: (9 C, N)."""
    point, cross, seen = (np.stack(parts) for parts in zip(*_by_view(given), strict=True))
    counted = seen.sum(axis=0).astype(np.float32)
    return (np.concatenate([*_order_statistics(point, seen), *_order_statistics(cross, seen), counted]),)


def _by_view(given: PhotoConsistencyInput) -> list[tuple[Array, Array, NDArray[np.bool_]]]:
    """Return per view (C, N): differences of the point and of the cross, and whether it sees the point."""
    height, width = given.core.shape
    u, v = given.u.astype(np.float64), given.v.astype(np.float64)
    s, slope_u, slope_v = (plane.astype(np.float64) for plane in given.planes)
    at = given.v.astype(int), given.u.astype(int)
    found: list[tuple[Array, Array, NDArray[np.bool_]]] = []
    for image, view, buffer, gain in zip(given.images, given.views, given.buffers, given.gains, strict=True):
        each: list[Array] = []
        seen: NDArray[np.bool_] = np.zeros(s.shape, bool)
        for du, dv in CROSS:
            own = np.clip(at[0] + dv, 0, height - 1), np.clip(at[1] + du, 0, width - 1)
            x, y, inverse_depth = project(view, u + du, v + dv, s + slope_u * du + slope_v * dv)
            off = given.core[own] - gain[at] * bilinear(image.astype(np.float64), x, y)
            unlike = np.minimum(off**2 / given.variance[own], MOST_UNLIKE)
            each.append(np.where(np.isnan(unlike), MOST_UNLIKE, unlike))
            if (du, dv) == (0, 0):
                seen = clear(buffer, x, y, inverse_depth + given.tolerance)
        found.append((each[0], np.mean(each, axis=0), seen))
    return found


def _order_statistics(unlike: Array, seen: NDArray[np.bool_]) -> list[NDArray[np.float32]]:
    """Return least, second, mean and most (C, N) of the views (n, C, N) that see the point."""
    views, none = seen.sum(axis=0), ~seen.any(axis=0)
    ranked = np.sort(np.where(seen, unlike, MOST_UNLIKE), axis=0)
    second = cast("NDArray[np.float64]", np.where(views > 1, ranked[min(1, len(ranked) - 1)], ranked[0]))
    counted = np.where(seen, unlike, 0)
    mean = np.where(none, MOST_UNLIKE, counted.sum(axis=0) / np.maximum(views, 1))
    most = np.where(none, MOST_UNLIKE, counted.max(axis=0))
    return [part.astype(np.float32) for part in (ranked[0], second, mean, most)]
