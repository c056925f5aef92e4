"""Rivals for doubtful pixels and how like the images they are: the reference of `rivals` and `likenesses`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.check_rivals import LikenessesInput, RivalsInput, likenesses_input, rivals_input
from beltscape.kernels.protocol.rivals import RIVALS, Likenesses, Rivals
from beltscape.kernels.reference.propagation import bilinear, clear, finite_or_zero
from beltscape.kernels.reference.view import see

Array = NDArray[np.float64]

STEEPEST = 1.5
MOST_UNLIKE = 50.0
DIRECTIONS = tuple((dx, dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dx or dy)
CROSS = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))


def rivals(
    s: NDArray[np.floating],
    slope_u: NDArray[np.floating],
    slope_v: NDArray[np.floating],
    trusted: NDArray[np.uint8],
    u: NDArray[np.integer],
    v: NDArray[np.integer],
    *,
    reach: int,
    same: float,
    threads: int = 0,
) -> Rivals:
    """See `beltscape.kernels.protocol.rivals`; ``threads`` is ignored here."""
    del threads
    given = rivals_input(s, slope_u, slope_v, trusted, u, v, reach, same)
    at = given.v.astype(int), given.u.astype(int)
    level, *slopes = (plane.astype(np.float64) for plane in given.surface)
    slopes = [np.clip(finite_or_zero(slope), -STEEPEST, STEEPEST) for slope in slopes]
    own = np.where(np.isfinite(level), 0, np.nan)[at]
    rows = [(level[at] + own, slopes[0][at] + own, slopes[1][at] + own, own)]
    rows += [_handed(given, (level, *slopes), at, dx, dy) for dx, dy in DIRECTIONS]
    found = [np.stack(parts) for parts in zip(*rows, strict=True)]
    return Rivals(*(np.asarray(part, np.float32) for part in (*found, _support(found[0], found[3], same))))


def _handed(
    given: RivalsInput,
    surface: tuple[Array, ...],
    at: tuple[NDArray[np.int_], NDArray[np.int_]],
    dx: int,
    dy: int,
) -> tuple[Array, ...]:
    """(N,) each: s, slopes and distance of what the first trusted pixel of a direction hands on."""
    height, width = given.trusted.shape
    out = [np.full(len(at[0]), np.nan) for _ in range(4)]
    for step in range(1, given.reach + 1):
        y, x = at[0] + step * dy, at[1] + step * dx
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        y, x = np.where(inside, y, 0), np.where(inside, x, 0)
        s, slope_u, slope_v = (plane[y, x] for plane in surface)
        new = inside & (given.trusted[y, x] > 0) & np.isfinite(s) & np.isnan(out[3])
        here = s - slope_u * step * dx - slope_v * step * dy, slope_u, slope_v, np.full(len(s), step)
        out = [np.where(new, value, kept) for value, kept in zip(here, out, strict=True)]
    return tuple(out)


def _support(s: Array, distance: Array, same: float) -> Array:
    """(9, N) how many others say the same, each by the less the farther away it is; not the pixel's own."""
    support = np.zeros_like(s)
    for i in range(RIVALS):
        for k in range(1, RIVALS):
            if k != i:
                support[i] += np.where(np.abs(s[i] - s[k]) < same, 1 / (1 + distance[k]), 0)
    return support


def likenesses(
    u: NDArray[np.integer],
    v: NDArray[np.integer],
    s: NDArray[np.floating],
    slope_u: NDArray[np.floating],
    slope_v: NDArray[np.floating],
    *,
    core: NDArray[np.floating],
    variance: NDArray[np.floating],
    images: Sequence[NDArray[np.floating]],
    views: NDArray[np.floating],
    buffers: Sequence[NDArray[np.floating]],
    gains: Sequence[NDArray[np.floating]],
    tolerance: float,
    threads: int = 0,
) -> Likenesses:
    """See `beltscape.kernels.protocol.rivals`; ``threads`` is ignored here."""
    del threads
    given = likenesses_input(
        u, v, (s, slope_u, slope_v), core=core, variance=variance, images=images, views=views, buffers=buffers,
        gains=gains, tolerance=tolerance,
    )  # fmt: skip
    point, cross, seen = (np.stack(parts) for parts in zip(*_by_view(given), strict=True))
    counted = seen.sum(axis=0).astype(np.float32)
    return Likenesses(*_ordered(point, seen), *_ordered(cross, seen), counted)


def _by_view(given: LikenessesInput) -> list[tuple[Array, Array, NDArray[np.bool_]]]:
    """Per view (C, N): differences of the point and of the cross, and whether it sees the point."""
    height, width = given.core.shape
    u, v = given.u.astype(np.float64), given.v.astype(np.float64)
    s, slope_u, slope_v = (plane.astype(np.float64) for plane in given.planes)
    at = given.v.astype(int), given.u.astype(int)
    found = []
    for image, view, buffer, gain in zip(given.images, given.views, given.buffers, given.gains, strict=True):
        each, seen = [], np.zeros(s.shape, bool)
        for du, dv in CROSS:
            own = np.clip(at[0] + dv, 0, height - 1), np.clip(at[1] + du, 0, width - 1)
            x, y, nearness = see(view, u + du, v + dv, s + slope_u * du + slope_v * dv)
            off = given.core[own] - gain[at] * bilinear(image.astype(np.float64), x, y)
            unlike = np.minimum(off**2 / given.variance[own], MOST_UNLIKE)
            each.append(np.where(np.isnan(unlike), MOST_UNLIKE, unlike))
            if (du, dv) == (0, 0):
                seen = clear(buffer, x, y, nearness + given.tolerance)
        found.append((each[0], np.mean(each, axis=0), seen))
    return found


def _ordered(unlike: Array, seen: NDArray[np.bool_]) -> list[NDArray[np.float32]]:
    """Least, second, mean and most (C, N) of the views (n, C, N) that see it."""
    views, none = seen.sum(axis=0), ~seen.any(axis=0)
    ranked = np.sort(np.where(seen, unlike, MOST_UNLIKE), axis=0)
    second = np.where(views > 1, ranked[min(1, len(ranked) - 1)], ranked[0])
    counted = np.where(seen, unlike, 0)
    mean = np.where(none, MOST_UNLIKE, counted.sum(axis=0) / np.maximum(views, 1))
    most = np.where(none, MOST_UNLIKE, counted.max(axis=0))
    return [part.astype(np.float32) for part in (ranked[0], second, mean, most)]
