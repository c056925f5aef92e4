"""Candidates and their photo-consistency: the reference of `candidate_surfaces` and `photo_consistency`."""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.reference.sampling import bilinear
from beltscape.kernels.reference.selection.propagation import clear, finite_or_zero
from beltscape.kernels.reference.view import project
from beltscape.kernels.selection.candidates import CANDIDATES, CandidatesInput, PhotoConsistencyInput

Array = NDArray[np.float64]

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
