"""Propagation of candidates between neighbours: the reference of `propagate`."""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.reference.sampling import bilinear, centred_windows, is_inside, window_dissimilarity
from beltscape.kernels.reference.selection.semi_global import NO_CANDIDATE, Kept, choose
from beltscape.kernels.reference.view import project
from beltscape.kernels.selection.propagation import PropagationInput

Array = NDArray[np.float64]

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
