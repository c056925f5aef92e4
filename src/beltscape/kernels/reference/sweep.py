"""The references of the kernels of the sweep: dissimilarity plane by plane, and semi-global aggregation.

Costs are aggregated over eight paths.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Array
from beltscape.kernels.reference.view import (
    bilinear,
    centred_windows,
    interpolate_cubic,
    project,
    window_dissimilarity,
)
from beltscape.kernels.sweep import WORST, AggregateInput, SweepAndAggregateInput, SweepInput, bands

PATHS = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dy, dx) != (0, 0)]
"""Steps (dy, dx) along the eight paths."""


def aggregate(given: AggregateInput) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return plane and margin (rows, W) each."""
    cost, small_jump, large_jump = given
    cost_of_plane = np.minimum(cost, WORST).astype(np.float64)
    sums = np.sum([_path(cost_of_plane, dy, dx, small_jump, large_jump) for dy, dx in PATHS], axis=0)
    return _decide(sums)


def _path(cost: Array, dy: int, dx: int, small_jump: int, large_jump: int) -> Array:
    """Return the costs (rows, W, D) along paths that come from (y + dy, x + dx)."""
    rows, width, _ = cost.shape
    path = cost.copy()
    for y in range(rows) if dy <= 0 else range(rows - 1, -1, -1):
        for x in range(width) if dx <= 0 else range(width - 1, -1, -1):
            if not (0 <= y + dy < rows and 0 <= x + dx < width):
                continue
            before = path[y + dy, x + dx]
            padded = np.pad(before, 1, constant_values=np.inf)
            neighbour = np.minimum(padded[:-2], padded[2:]) + small_jump
            least = before.min()
            path[y, x] += np.minimum(np.minimum(before, neighbour), least + large_jump) - least
    return path


def _decide(sums: Array) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return planes and margins (rows, W) from sums (rows, W, D)."""
    planes = np.arange(int(sums.shape[2]))
    best = sums.argmin(axis=2)
    at = best[..., None]
    least = np.take_along_axis(sums, at, axis=2)
    other = np.where(abs(planes - at) > 1, sums, np.inf).min(axis=2)
    left = np.take_along_axis(sums, np.maximum(at - 1, 0), axis=2)
    right = np.take_along_axis(sums, np.minimum(at + 1, planes[-1]), axis=2)
    rise = np.maximum(left, right) - least
    inner = (at > 0) & (at < planes[-1]) & (rise > 0)
    part = np.where(inner, 0.5 * (left - right) / np.where(rise > 0, rise, 1), 0)[..., 0]
    return (best + part).astype(np.float32), ((other - least[..., 0]) / (len(PATHS) * WORST)).astype(
        np.float32
    )


def sweep(given: SweepInput, rows: int) -> tuple[NDArray[np.uint8]]:
    """Return the costs (rows, W, planes)."""
    aligned = [
        _AlignedImage.align(image, view, given) for image, view in zip(given.images, given.views, strict=True)
    ]
    planes = given.first + given.step * np.arange(given.planes)
    cost = np.stack([_plane(given, s, aligned) for s in planes], axis=-1)
    return (cost[given.first_row : given.first_row + rows],)


def sweep_and_aggregate(given: SweepAndAggregateInput) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return plane and margin (H, W) each."""
    kept: list[list[NDArray[np.float32]]] = []
    for band in bands(len(given.core)):
        (cost,) = sweep(SweepInput(*given[:8], band.first), band.last - band.first)
        middle = slice(band.keep_first - band.first, band.keep_last - band.first)
        parts = aggregate(AggregateInput(cost, given.small_jump, given.large_jump))
        kept.append([part[middle] for part in parts])
    index, margin = (np.concatenate(part) for part in zip(*kept, strict=True))
    return index, margin


def _plane(given: SweepInput, s: float, aligned: list[_AlignedImage]) -> NDArray[np.uint8]:
    """Return the costs (H, W) of one plane."""
    core = centred_windows(given.core.astype(np.float64))
    each = [
        window_dissimilarity(core, centred_windows(image.sample(s, given.core.shape)), given.floor)
        for image in aligned
    ]
    mean = np.sort(each, axis=0)[: given.best].mean(axis=0)
    return np.floor(WORST * mean + 0.5).astype(np.uint8)


MOST_SCALE = 4.0
"""Largest scale of a plane in an aligned image: beyond it, an auxiliary does not see the plane."""


@dataclass(frozen=True)
class _AlignedImage:
    """An auxiliary's image in the directions of the core's grid, over the field that the planes take of it.

    The auxiliary sees core pixel (x, y) at inverse depth s, which lies at direction @ (x, y, 1) + shift · s in its
    frame, at (x + s g_u, y + s g_v) / (1 + s g_z) here, with g = direction⁻¹ @ shift.
    """

    levels: Array
    """(h, w) grey levels, the first at (left, top); NaN where the auxiliary sees nothing."""
    left: int
    top: int
    shift: Array
    """(3,) g."""

    @classmethod
    def align(
        cls, image: NDArray[np.floating], view: NDArray[np.floating], given: SweepInput
    ) -> _AlignedImage:
        direction, shift = np.asarray(view[:9], np.float64).reshape(3, 3), np.asarray(view[9:12], np.float64)
        g: Array = np.linalg.solve(direction, shift).astype(np.float64)
        s = given.first + given.step * np.arange(given.planes)
        scale = 1 / (1 + s * g[2])
        seen = (scale > 0) & (scale <= MOST_SCALE)
        if not seen.any() or min(image.shape) < 4:
            return cls(np.empty((0, 0)), 0, 0, g)
        (height, width), s, scale = given.core.shape, s[seen], scale[seen]
        u, v = scale * s * g[0], scale * s * g[1]
        left, top = int(np.floor(u.min())) - 1, int(np.floor(v.min())) - 1
        columns = np.arange(left, np.floor((scale * (width - 1) + u).max()) + 3)
        rows = np.arange(top, np.floor((scale * (height - 1) + v).max()) + 3)
        grid_v, grid_u = np.meshgrid(rows, columns, indexing="ij")
        seen_u, seen_v, _ = project(view, grid_u, grid_v, np.zeros_like(grid_u))
        return cls(interpolate_cubic(image.astype(np.float64), seen_u, seen_v), left, top, g)

    def sample(self, s: float, shape: tuple[int, ...]) -> Array:
        """Return what the auxiliary sees of the plane on the core's grid (H, W), bilinearly; NaN: nothing."""
        scale = 1 / (1 + s * self.shift[2])
        if not 0 < scale <= MOST_SCALE or not self.levels.size:
            return np.full(shape, np.nan)
        y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
        return bilinear(
            self.levels,
            (x + s * self.shift[0]) * scale - self.left,
            (y + s * self.shift[1]) * scale - self.top,
        )
