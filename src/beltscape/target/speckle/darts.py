"""Dart throwing: random points with a minimum distance between each other."""

from __future__ import annotations

from math import floor, sqrt

import numpy as np
from numpy.typing import NDArray

GRAINS = 1000
"""Positions are whole thousandths of a pixel, so that distances are compared in exact integers."""

RASTER_CELLS = 8
"""Cells of the raster of free positions per d_min."""

MAX_EMPTY_ROUNDS = 20
"""Rounds of at least MIN_ROUND darts without an accepted one after which the plane counts as full."""

MIN_ROUND, MAX_ROUND = 16384, 65536
"""Least and largest number of darts thrown at once, which bound the calls and the memory."""


def throw_darts(
    size_px: tuple[int, int],
    count: int,
    d_min_px: float,
    keep_out: NDArray[np.float64],
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """Return up to ``count`` random points, each accepted only if farther than ``d_min_px`` from those before.

    Only darts that are certainly rejected (into raster cells wholly covered by one accepted dot) are omitted, so that
    accepted points are distributed as if every dart had been thrown at the whole plane. Fewer than ``count``
    points are returned when the plane is full.

    Parameters
    ----------
    size_px
        Width and height; points lie in [-0.5, W - 0.5] × [-0.5, H - 0.5].
    keep_out
        (K, 3) x, y, radius of discs, px, that must contain no point.

    Returns
    -------
    (N, 2) float64 points in the order of acceptance, px, N ≤ count.

    References
    ----------
    Hou, Kang & Qiao, Sensors 2025, 25(7), 2111, doi:10.3390/s25072111, Eqs. 4-5.
    """
    plane = _Plane(size_px, d_min_px, np.asarray(keep_out, dtype=np.float64))
    empty_rounds = 0
    while plane.count < count and empty_rounds < MAX_EMPTY_ROUNDS:
        missing = count - plane.count
        darts = plane.draw_darts(rng, min(max(2 * missing, MIN_ROUND), MAX_ROUND))
        if darts.size == 0:
            break
        accepted = plane.reject_close(darts)[: plane.max_hits]
        accepted = accepted[_resolve_conflicts(accepted, plane.limit)][:missing]
        plane.add(accepted)
        empty_rounds = 0 if accepted.size else empty_rounds + 1
    return (plane.points[: plane.count] - GRAINS / 2).astype(np.float64) / GRAINS


class _Plane:
    """The accepted points in grains from the image's corner, a grid for neighbours, a raster of free positions."""

    def __init__(self, size_px: tuple[int, int], d_min_px: float, keep_out: NDArray[np.float64]) -> None:
        self.size = np.array(size_px) * GRAINS
        d = d_min_px * GRAINS
        self.limit = floor(d * d + 1e-3)  # squared distances up to this are too close; ties are rejected
        self.max_hits = 64 + int(
            2 * self.size.prod() / self.limit
        )  # more at once would mostly conflict with each other
        self.keep_out = np.column_stack([keep_out[:, :2] + 0.5, keep_out[:, 2]]) * GRAINS
        self.cell = d / sqrt(2)  # at most one point in a cell
        columns, rows = (np.floor(self.size / self.cell) + 5).astype(int)
        self.index = np.full((rows, columns), -1, dtype=np.int64)
        self.fine = d / RASTER_CELLS
        width, height = np.ceil(self.size / self.fine).astype(int)
        self.free = np.ones((height, width), dtype=bool)
        self.points = np.full((1, 2), -(10**9), dtype=np.int64)  # the last row represents an empty cell
        self.count = 0

    def draw_darts(self, rng: np.random.Generator, count: int) -> NDArray[np.int64]:
        """Return (count, 2) darts, uniform over the free raster cells; none when there is no free cell."""
        cells = np.flatnonzero(self.free)
        if cells.size == 0:
            return np.empty((0, 2), dtype=np.int64)
        row, column = np.divmod(cells[rng.integers(cells.size, size=count)], self.free.shape[1])
        xy = (np.stack([column, row], axis=-1) + rng.random((count, 2))) * self.fine
        return np.rint(xy[(xy <= self.size).all(axis=1)]).astype(np.int64)

    def reject_close(self, darts: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the darts far enough from every accepted point and outside the keep-out discs."""
        for x, y, radius in self.keep_out:
            is_far = (darts[:, 0] - x) ** 2 + (darts[:, 1] - y) ** 2 > radius * radius
            darts = darts[is_far]
        column, row = self._cells(darts)
        for dy, dx in _NEIGHBOURS:
            neighbour = self.points[self.index[row + dy, column + dx]]
            is_far = ((darts - neighbour) ** 2).sum(axis=1) > self.limit
            darts, row, column = darts[is_far], row[is_far], column[is_far]
        return darts

    def add(self, points: NDArray[np.int64]) -> None:
        """Accept points and mark the raster cells that they cover."""
        column, row = self._cells(points)
        self.index[row, column] = self.count + np.arange(len(points))
        self.points = np.concatenate([self.points[:-1], points, self.points[-1:]])
        self.count += len(points)
        cells = np.floor(points / self.fine).astype(np.int64)
        height, width = self.free.shape
        for dx, dy in _COVERED:
            x, y = cells[:, 0] + dx, cells[:, 1] + dy
            inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
            self.free[y[inside], x[inside]] = False

    def _cells(self, points: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        column, row = np.floor(points.T / self.cell).astype(np.int64) + 2
        return column, row


_NEIGHBOURS = sorted(
    ((dy, dx) for dy in range(-2, 3) for dx in range(-2, 3) if abs(dx) + abs(dy) < 4),
    key=lambda offset: offset[0] ** 2 + offset[1] ** 2,
)
"""Grid cells that can contain a point within d_min, the nearest first."""

_COVERED = [
    (dx, dy)
    for dy in range(-RASTER_CELLS, RASTER_CELLS + 1)
    for dx in range(-RASTER_CELLS, RASTER_CELLS + 1)
    if (abs(dx) + 1) ** 2 + (abs(dy) + 1) ** 2 <= RASTER_CELLS**2
]
"""Raster cells that a dot covers wholly, wherever it lies in its own cell."""


def _resolve_conflicts(darts: NDArray[np.int64], limit: int) -> NDArray[np.bool_]:
    """Return which darts of one round are accepted when each is compared with all accepted before it."""
    from scipy.spatial import KDTree

    is_accepted = np.ones(len(darts), dtype=bool)
    if len(darts) < 2:
        return is_accepted
    pairs = KDTree(darts).query_pairs(sqrt(limit) + 1, output_type="ndarray")  # earlier, later
    pairs = pairs[((darts[pairs[:, 0]] - darts[pairs[:, 1]]) ** 2).sum(axis=1) <= limit]
    is_decided = is_accepted.copy()
    while pairs.size:
        is_decided[pairs[:, 1]] = (
            False  # remaining: darts without an undecided earlier neighbour; they are accepted
        )
        rejected = pairs[is_decided[pairs[:, 0]], 1]
        is_accepted[rejected] = False
        pairs = pairs[~is_decided[pairs[:, 0]] & is_accepted[pairs[:, 0]] & is_accepted[pairs[:, 1]]]
        is_decided[:] = is_accepted
    return is_accepted
