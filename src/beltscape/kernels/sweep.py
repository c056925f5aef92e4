"""Plane sweep and semi-global aggregation: a first surface from all auxiliaries at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.arrays import float32, sampled_images
from beltscape.kernels.backend import KernelFamily
from beltscape.kernels.projection import PROJECTION_SIZE
from beltscape.kernels.resident import ResidentArray

BAND_ROWS = 64
"""Rows of a band, of which each is aggregated by itself; its costs fit the memory that a thread may use."""
HALO_ROWS = 16
"""Rows beyond a band from which its paths begin."""


class RowBand(NamedTuple):
    """Rows first … last - 1 of which keep_first … keep_last - 1 are kept."""

    first: int
    keep_first: int
    keep_last: int
    last: int


def bands(height: int) -> list[RowBand]:
    """Return bands whose kept rows cover ``height`` rows once."""
    return [
        RowBand(max(0, y - HALO_ROWS), y, end, min(height, end + HALO_ROWS))
        for y in range(0, height, BAND_ROWS)
        for end in [min(height, y + BAND_ROWS)]
    ]


WORST = 120
"""The cost of a dissimilarity of 1; costs above it count as this. With jumps of together 135 and less, sums along a
path fit a byte, the fast case of native/sweep/aggregate.hpp."""
LEAST_PLANES, MOST_PLANES = 4, 4096
"""With at least 4 planes, every plane has one that is not its neighbour."""
LARGEST_JUMP = 8000
"""Sums over eight paths, each of at most this and a cost, fit 16 bits: 8 · (8000 + 120) < 65,536."""
SLAB_BYTES = 1 << 26
"""Bytes of costs that `sweep_and_aggregate` holds at once (64 MB); no result depends on it."""


class SweepInput(NamedTuple):
    """Checked input of `sweep`."""

    core: NDArray[np.float32]
    """(H, W) grey levels."""
    images: list[NDArray[np.float32]]
    """n of (h, w) grey levels, each at least 2 × 2."""
    views: NDArray[np.float32]
    """(n, 39), see `beltscape.kernels.reference.view.project`."""
    first: float
    step: float
    planes: int
    floor: float
    best: int
    """How many views are averaged; at most n."""
    first_row: int
    """The first of the rows of the result."""


class AggregateInput(NamedTuple):
    """Checked input of `aggregate`."""

    cost: NDArray[np.uint8]
    """(rows, W, D)"""
    small_jump: int
    large_jump: int


class SweepAndAggregateInput(NamedTuple):
    """Checked input of `sweep_and_aggregate`: that of `sweep` and of `aggregate`, and the cut into bands."""

    core: NDArray[np.float32]
    images: list[NDArray[np.float32]]
    views: NDArray[np.float32]
    first: float
    step: float
    planes: int
    floor: float
    best: int
    small_jump: int
    large_jump: int
    band_rows: int
    halo_rows: int
    slab_rows: int


class PlaneSweepKernels(KernelFamily):
    """Kernels that choose the plane of every core pixel with all auxiliaries at once."""

    def sweep(
        self,
        core: NDArray[np.float32],
        images: Sequence[NDArray[np.float32]],
        views: NDArray[np.float32],
        first: float,
        step: float,
        planes: int,
        floor: float,
        *,
        rows: tuple[int, int] | None = None,
        best: int = 2,
        threads: int = 0,
    ) -> NDArray[np.uint8]:
        """Return the dissimilarity of auxiliaries and core on every plane of inverse depth.

        Windows of 3 × 3 pixels of the core's grid (its border repeated) are compared by

            c = Σ((I-Ī) - (J-J̄))² / (Σ(I-Ī)² + Σ(J-J̄)² + 18 floor),  at most 1,

        with I the core and J an auxiliary sampled where it sees the plane; c = 1 where one of the window's samples
        is not seen or NaN. The ``best`` smallest are averaged. An auxiliary is sampled twice: first its image is
        turned into the directions of the core's grid, free of lens and rotation, by cubic interpolation (4 × 4
        pixels); then every plane only scales and moves that, and is sampled bilinearly. It does not see a plane to
        which it is four times as near as the core.

        Parameters
        ----------
        core
            (H, W) grey levels, undistorted.
        images
            n of (h, w) grey levels, as the auxiliaries took them.
        views
            (n, 39) how each sees the core's pixels: `beltscape.kernels.reference.view.project`.
        first, step, planes
            Plane d has the inverse depth first + step · d; 4 to 4096 planes.
        floor
            A variance in grey levels² below which texture counts as noise; positive.
        rows
            First row and the one after the last; all when left out.
        best
            How many views are averaged; all where there are fewer.

        Returns
        -------
        (rows, W, planes) uint8: 120 c, rounded.
        """
        given = _checked(core, images, views, first, step, planes, floor, rows=rows, best=best)
        end_row = rows[1] if rows else len(given.core)
        shape = end_row - given.first_row, given.core.shape[1], planes
        (cost,) = self._run("sweep", given, (np.empty(shape, np.uint8),), threads)
        return cost

    def aggregate(
        self, cost: NDArray[np.uint8], small_jump: int, large_jump: int
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the plane of every pixel by semi-global aggregation over eight paths; on one thread.

        Parameters
        ----------
        cost
            (rows, W, D) of at most 120 (more counts as 120), 4 ≤ D ≤ 4096.
        small_jump, large_jump
            Cost of a step of one plane, and of more: 0 ≤ small ≤ large ≤ 8000. Up to small + large = 135 and
            large = 127 the kernel computes in bytes instead of 16 bits.

        Returns
        -------
        (rows, W) plane of the least sum (the first of equals), interpolated by the symmetric V through it and its
        neighbours; (rows, W) margin, 0 …: the difference of the least sum of all planes but it and its neighbours, as
        a mean dissimilarity of a path.

        References
        ----------
        Hirschmüller, TPAMI 30(2), 2008, doi:10.1109/TPAMI.2007.1166.
        """
        given = AggregateInput(_checked_costs(cost), *_checked_jumps(small_jump, large_jump))
        out = np.empty(given.cost.shape[:2], np.float32), np.empty(given.cost.shape[:2], np.float32)
        index, margin = self._run("aggregate", given, out, 1)
        return index, margin

    def sweep_and_aggregate(  # noqa: PLR0917 (its parts take the same in the same order)
        self,
        core: NDArray[np.float32],
        images: Sequence[NDArray[np.float32]],
        views: NDArray[np.float32],
        first: float,
        step: float,
        planes: int,
        floor: float,
        small_jump: int,
        large_jump: int,
        *,
        best: int = 2,
        threads: int = 0,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the plane of every pixel by `sweep` and `aggregate`, in bands of rows that overlap.

        The result is that of both over each of `beltscape.kernels.sweep.bands`, of which the middle is kept.
        The kernel holds up to 64 MB of costs and, for each thread, two bytes for each cost of a band of 64 rows.

        Returns
        -------
        (H, W) plane and (H, W) margin, as from `aggregate`.
        """
        swept = _checked(core, images, views, first, step, planes, floor, rows=None, best=best)
        bands = BAND_ROWS, HALO_ROWS, _slab_rows(swept)
        given = SweepAndAggregateInput(*swept[:8], *_checked_jumps(small_jump, large_jump), *bands)
        out = np.empty(given.core.shape, np.float32), np.empty(given.core.shape, np.float32)
        index, margin = self._run("sweep_and_aggregate", given, out, threads)
        return index, margin


def _checked(
    core: NDArray[np.floating],
    images: Sequence[NDArray[np.floating]],
    views: NDArray[np.floating],
    first: float,
    step: float,
    planes: int,
    floor: float,
    *,
    rows: tuple[int, int] | None,
    best: int,
) -> SweepInput:
    """Return the checked input of `sweep`, of all rows where ``rows`` is None, or raise KernelError."""
    core = float32("core", core, ("H", "W"))
    if not images:
        raise KernelError("a sweep needs at least one auxiliary image")
    images = sampled_images(images)
    views = float32("views", views, (len(images), PROJECTION_SIZE))
    height = core.shape[0]
    rows = rows or (0, height)
    if not 0 <= rows[0] < rows[1] <= height:
        raise KernelError(f"rows must lie within (0, {height}), not {rows}")
    if not LEAST_PLANES <= planes <= MOST_PLANES:
        raise KernelError(f"planes must be {LEAST_PLANES} to {MOST_PLANES}, not {planes}")
    if not (isinstance(floor, ResidentArray) or floor > 0):
        raise KernelError(f"floor must be positive, not {floor}")
    if not best >= 1:
        raise KernelError(f"best must be at least 1, not {best}")
    return SweepInput(core, images, views, first, step, planes, floor, min(best, len(images)), rows[0])


def _checked_jumps(small_jump: int, large_jump: int) -> tuple[int, int]:
    """Return both as they are, or raise KernelError."""
    if not 0 <= small_jump <= large_jump <= LARGEST_JUMP:
        raise KernelError(
            f"jumps must be 0 <= small_jump <= large_jump <= {LARGEST_JUMP}, not {small_jump} and {large_jump}"
        )
    return small_jump, large_jump


def _checked_costs(cost: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return contiguous (rows, W, D) uint8 with a valid number of planes D, or raise KernelError."""
    fits = cost.ndim == 3 and cost.dtype == np.uint8 and min(cost.shape) > 0
    if not fits or not LEAST_PLANES <= cost.shape[2] <= MOST_PLANES:
        raise KernelError(
            f"cost must be uint8 (rows, W, D) with D from {LEAST_PLANES} to {MOST_PLANES}, "
            f"not {cost.dtype} {cost.shape}"
        )
    return np.ascontiguousarray(cost)


def _slab_rows(given: SweepInput) -> int:
    """Return the number of rows, in whole bands, whose costs fit SLAB_BYTES; the result does not depend on it."""
    return BAND_ROWS * max(1, SLAB_BYTES // (BAND_ROWS * given.core.shape[1] * given.planes))
