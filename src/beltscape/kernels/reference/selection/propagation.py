"""Candidates handed on by neighbours, and which of them pixels keep: the reference of `propagate`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.reference.selection.semi_global import NO_CANDIDATE, Kept, choose
from beltscape.kernels.reference.view import project
from beltscape.kernels.selection.propagation import PropagationInput

Array = NDArray[np.float64]

NO_COST = 1e3
FARTHEST_STEP = 3.0
BAND_ROWS = 128
HALO_ROWS = 12


def propagate(given: PropagationInput) -> tuple[NDArray[np.floating], ...]:
    """Return the fields of Propagated, (H, W) each."""
    kept = _kept(given)
    height = given.core.shape[0]
    bands = []
    for first in range(0, height, BAND_ROWS):
        end = min(height, first + BAND_ROWS)
        above, below = max(0, first - HALO_ROWS), min(height, end + HALO_ROWS)
        band = choose(kept.rows(above, below), given.costs.small_jump, given.costs.large_jump)
        bands.append([field[first - above : end - above] for field in band])
    return tuple(np.concatenate(parts) for parts in zip(*bands, strict=True))


def _kept(given: PropagationInput) -> Kept:
    """The candidates (H, W, K) that the pixels keep."""
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
    """The values as float64, 0 for those that are not finite."""
    return np.where(np.isfinite(a), a, 0).astype(np.float64)


def shifted_candidate(given: PropagationInput, dx: int, dy: int) -> tuple[Array, Array, Array]:
    """(H, W) each: the candidate of an offset and its slopes."""
    s, slope_u, slope_v = given.surface
    height, width = s.shape
    y, x = np.indices(s.shape)
    from_y, from_x = np.clip(y - dy, 0, height - 1), np.clip(x - dx, 0, width - 1)
    slope_u, slope_v = finite_or_zero(slope_u[from_y, from_x]), finite_or_zero(slope_v[from_y, from_x])
    step = np.clip(slope_u * (x - from_x) + slope_v * (y - from_y), -FARTHEST_STEP, FARTHEST_STEP)
    return s[from_y, from_x] + step, slope_u, slope_v


def dissimilarity(given: PropagationInput, s: Array) -> Array:
    """(H, W) of the surface s, over the views in which each pixel is seen."""
    y, x = np.indices(s.shape)
    core = _centred_windows(given.core.astype(np.float64))
    each, seen = [], []
    for image, view, buffer in zip(given.images, given.views, given.buffers, strict=True):
        u, v, inverse_depth = project(view, x, y, s)
        aux = _centred_windows(bilinear(image.astype(np.float64), u, v))
        energy = (core**2).sum(axis=0) + (aux**2).sum(axis=0) + 18 * given.costs.floor
        c = ((core - aux) ** 2).sum(axis=0) / energy
        each.append(np.where(np.isnan(c), 1, np.minimum(c, 1)))
        seen.append(clear(buffer, u, v, inverse_depth + given.costs.tolerance))
    return _agreement(np.array(each), np.array(seen), given.costs.unseen_cost)


def _agreement(each: Array, seen: NDArray[np.bool_], unseen_cost: float) -> Array:
    """(H, W) of the (n, H, W) dissimilarities those that are seen: their mean, without the worst of three or more."""
    views, counted = seen.sum(axis=0), np.where(seen, each, 0)
    total, worst = counted.sum(axis=0), counted.max(axis=0)
    mean = np.where(views > 2, (total - worst) / np.maximum(views - 1, 1), total / np.maximum(views, 1))
    return np.where(views > 0, mean, unseen_cost)


def clear(buffer: NDArray[np.floating], u: Array, v: Array, reach: Array) -> NDArray[np.bool_]:
    """(H, W): inside the image, and nothing in the buffer (h, w) before ``reach`` at the nearest pixel."""
    inside = _inside(buffer.shape, u, v)
    x, y = (np.floor(np.where(inside, a, 0) + 0.5).astype(int) for a in (u, v))
    return inside & (buffer[y, x] <= np.where(inside, reach, 0))


def _inside(shape: tuple[int, ...], u: Array, v: Array) -> NDArray[np.bool_]:
    """Whether the 2 × 2 footprint of (u, v) is within an image (h, w)."""
    return (u >= 0) & (u < shape[1] - 1) & (v >= 0) & (v < shape[0] - 1)


def _centred_windows(image: Array) -> Array:
    """(9, H, W): the 3 × 3 neighbours of every pixel without their mean, the border repeated."""
    height, width = image.shape
    padded = np.pad(image, 1, mode="edge")
    windows = np.stack([padded[y : y + height, x : x + width] for y in range(3) for x in range(3)])
    return windows - windows.mean(axis=0)


def bilinear(image: Array, u: Array, v: Array) -> Array:
    """The image (h, w) at (u, v); NaN where the 2 × 2 footprint is not inside."""
    inside = _inside(image.shape, u, v)
    u, v = np.where(inside, u, 0), np.where(inside, v, 0)
    x, y = u.astype(int), v.astype(int)
    u, v = u - x, v - y
    above = (1 - u) * image[y, x] + u * image[y, x + 1]
    below = (1 - u) * image[y + 1, x] + u * image[y + 1, x + 1]
    return np.where(inside, (1 - v) * above + v * below, np.nan)


def _keep(
    kept: Kept, candidate: tuple[Array, Array, Array, Array], separation: float, allowed: NDArray[np.bool_]
) -> None:
    """Puts a candidate (s, slope_u, slope_v, cost), (H, W) each, in its place where it is cheaper."""
    s, cost = candidate[0], candidate[3]
    near = np.abs(kept.s - s[..., None]) < separation
    place = np.where(near.any(axis=2), near.argmax(axis=2), kept.cost.argmax(axis=2))
    there = np.take_along_axis(kept.cost, place[..., None], axis=2)[..., 0]
    y, x = np.nonzero(allowed & (cost < there))
    for field, value in zip(kept, candidate, strict=True):
        field[y, x, place[y, x]] = value[y, x]
