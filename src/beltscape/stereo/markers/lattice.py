"""Search for rows and columns among marker detections by interval thresholds (the paper's Section 2.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.markers.detection import MarkerDetections

_INTERVAL, _INTERVAL_OF_DISC = 0.2, 0.25
"""Interval threshold: largest distance of a neighbour from its predicted position, in steps; the second is
added for a perfect disc. Relief shifts markers, as does perspective that few neighbours do not determine; the next
position begins at half a step."""
_MAX_DEVIATION = 1.5
"""Largest deviation of a marker from the fitted grid, in interval thresholds."""
_STEP_RADII = (5.0, 32.0)
"""Range of the distance of neighbours in radii: 11.5 and 18.5 in the pattern, unless foreshortened or half hidden."""
_MAX_STEP_RATIO = 3.0
"""Largest ratio of the steps along and across: 1.6 in the pattern, more in a slanting view."""
_RADIUS_RATIOS = (0.3, 1.7)
"""Range of a radius over the median of the grid's: torn by relief, or nearer to the camera."""
_TURN_DEG = 50.0
"""Largest angle of the steps with the image's axes; the orientation is decided afterwards."""
_MAX_NEIGHBOURS = 4
"""Number of nearest detections on either side that are tried as neighbours."""
_MAX_SEEDS = 16
"""Number of best seeds that are grown."""
_MIN_MARKERS = 6
"""Least number of markers in a grid; fewer can be chance."""
_STIFFNESS = 0.5
"""Weight against perspective, per step of the grid: three points determine an affine map, sixteen a homography."""

Cells = dict[int, tuple[int, int]]
"""Detection → column, row."""


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Detections in rows and columns, of which the first ones have number 0."""

    index: NDArray[np.int64]
    """(n,) indices of the detections."""
    cell: NDArray[np.int64]
    """(n, 2) column, row, from 0."""
    score: float
    """Sum of the detections' confidence, weighted less with their deviation from the fitted grid."""


def find_lattice(markers: MarkerDetections, columns: int = 4, rows: int = 4) -> Lattice | None:
    """Return the best part of a grid of at most ``columns`` × ``rows`` (or turned) among the detections, or None.

    Every detection with a neighbour along and one across is a seed (exhaustive RANSAC); the best ones are grown
    neighbour by neighbour. A position is predicted from the known neighbours and the step of a homography fitted to
    all of them, so perspective and shifts by relief are allowed.
    """
    best: Lattice | None = None
    for seed in _find_seeds(markers):
        if best is not None and len(best.index) == columns * rows:
            break
        grown = _grow_lattice(markers, seed, (columns, rows))
        if len(grown.index) >= _MIN_MARKERS and (best is None or grown.score > best.score):
            best = grown
    return best


def fit_homography(cells: NDArray[np.floating], points_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (3, 3) homography cells (n, 2) → points (n, 2), for n ≥ 3 that are not collinear.

    It is the linear least squares of u (1 + g c + h r) = a c + b r + d about the means, in steps of the grid, with g
    and h regularised towards zero, so few points determine an affine map.
    """
    middle, mean = cells.mean(axis=0), points_px.mean(axis=0)
    scale = max(float(np.abs(points_px - mean).max()), 1e-9) / max(float(np.abs(cells - middle).max()), 1e-9)
    (c, r), (u, v) = (cells - middle).T, ((points_px - mean) / scale).T
    one, nil = np.ones(len(c)), np.zeros(len(c))
    equations = np.concatenate(
        [
            np.stack([c, r, one, nil, nil, nil, -u * c, -u * r], axis=1),
            np.stack([nil, nil, nil, c, r, one, -v * c, -v * r], axis=1),
            _STIFFNESS * np.eye(8)[6:],
        ]
    )
    h = np.append(np.linalg.lstsq(equations, np.concatenate([u, v, [0, 0]]), rcond=None)[0], 1.0)
    to_middle = np.array([[1, 0, -middle[0]], [0, 1, -middle[1]], [0, 0, 1]])
    from_mean = np.array([[scale, 0, mean[0]], [0, scale, mean[1]], [0, 0, 1]])
    return from_mean @ h.reshape(3, 3) @ to_middle


def apply_homography(homography: NDArray[np.float64], cells: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the points (..., 2) of cells (..., 2)."""
    mapped = cells @ homography[:, :2].T + homography[:, 2]
    # cells behind the horizon become distant points
    return mapped[..., :2] / np.maximum(mapped[..., 2:], 1e-6)


def _find_seeds(markers: MarkerDetections) -> list[Cells]:
    """Return corners with their neighbours along and across, those that most detections fit first."""
    seeds = _list_corners(markers)
    if not seeds:
        return []
    at = markers.center_px
    members = np.array([list(seed) for seed in seeds])
    signs = np.array([[seed[i][k] for i, k in zip(list(seed)[1:], (0, 1), strict=True)] for seed in seeds])
    along, across = np.moveaxis((at[members[:, 1:]] - at[members[:, :1]]) * signs[..., None], 1, 0)
    # beyond two steps the error of an affine prediction exceeds the threshold
    steps = np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 3)), axis=-1).reshape(-1, 2)
    cells = np.linalg.inv(np.stack([along, across], axis=-1)) @ np.swapaxes(at - at[members[:, :1]], 1, 2)
    deviation = np.linalg.norm(np.swapaxes(cells, 1, 2)[:, None] - steps[:, None], axis=-1)
    hits = np.clip(1 - (deviation / _interval_thresholds(markers)) ** 2, 0, None) * (0.5 + markers.confidence)
    order = np.argsort(-hits.max(axis=2).sum(axis=1), kind="stable")[:_MAX_SEEDS]
    return [seeds[i] for i in order]


def _list_corners(markers: MarkerDetections) -> list[Cells]:
    """Return every detection with a possible neighbour along (about ±u) and one across (about ±v)."""
    at, radius = markers.center_px, markers.radius_px
    step = at[None] - at[:, None]
    distance = np.linalg.norm(step, axis=-1)
    radii = distance / np.maximum(radius[:, None], radius)
    near = (radii > _STEP_RADII[0]) & (radii < _STEP_RADII[1])
    along, across = (np.abs(step[..., k]) > np.cos(np.deg2rad(_TURN_DEG)) * distance for k in (0, 1))
    seeds: list[Cells] = []
    for corner in range(len(at)):
        for a in _list_nearest(distance[corner], near[corner] & along[corner]):
            for b in _list_nearest(distance[corner], near[corner] & across[corner]):
                (au, av), (bu, bv) = step[corner, a], step[corner, b]
                right, down = int(np.sign(au)), int(np.sign(bv))
                sine = (au * bv - av * bu) * right * down / (distance[corner, a] * distance[corner, b])
                if (
                    a != b
                    and sine > 0.5
                    and 1 / _MAX_STEP_RATIO < distance[corner, a] / distance[corner, b] < _MAX_STEP_RATIO
                ):
                    seeds.append({corner: (0, 0), int(a): (right, 0), int(b): (0, down)})
    return seeds


def _list_nearest(distance: NDArray[np.float64], allowed: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the indices of the nearest allowed detections."""
    index = np.flatnonzero(allowed)
    return index[np.argsort(distance[index], kind="stable")[: 2 * _MAX_NEIGHBOURS]]


def _grow_lattice(markers: MarkerDetections, seed: Cells, size: tuple[int, int]) -> Lattice:
    """Return the seed with all detections in its rows and columns."""
    cells = _grow_cells(markers, seed, size)
    deviation = _measure_deviations(markers, cells)
    kept = {i: cell for (i, cell), d in zip(cells.items(), deviation, strict=True) if d < _MAX_DEVIATION}
    if _MIN_MARKERS <= len(kept) < len(cells) and _spans_plane(kept):
        cells = _grow_cells(markers, kept, size)
        deviation = _measure_deviations(markers, cells)
    index = np.array(list(cells), np.int64)
    cell = np.array(list(cells.values()), np.int64)
    weight = np.clip(1 - deviation**2, 0, None)
    return Lattice(index, cell - cell.min(axis=0), float((weight * (0.5 + markers.confidence[index])).sum()))


def _grow_cells(markers: MarkerDetections, cells: Cells, size: tuple[int, int]) -> Cells:
    """Return the cells with all detections near a predicted free cell, from the nearest neighbours outwards."""
    cells = dict(cells)
    span = max(size)
    while True:
        added = False
        for gap in range(1, span):  # near neighbours predict a position best
            for _, index, cell in sorted(_predict_cells(markers, cells, size, gap)):
                if index not in cells and cell not in cells.values() and _select_fitting(cells, [cell], size):
                    cells[index] = cell
                    added = True
            if added:
                break
        if not added:
            return cells


def _predict_cells(
    markers: MarkerDetections, cells: Cells, size: tuple[int, int], gap: int
) -> list[tuple[float, int, tuple[int, int]]]:
    """Return deviation (0..1), index and cell of detections near free cells that are ``gap`` from occupied ones."""
    index = np.array(list(cells))
    occupied = np.array(list(cells.values()))
    model, at = fit_homography(occupied, markers.center_px[index]), markers.center_px
    threshold = _interval_thresholds(markers)
    relative = markers.radius_px / np.median(markers.radius_px[index])
    free = (relative > _RADIUS_RATIOS[0]) & (relative < _RADIUS_RATIOS[1])
    free[index] = False
    if not free.any():
        return []
    predicted: list[tuple[float, int, tuple[int, int]]] = []
    for cell in _list_free_cells(cells, size, gap):
        beside = np.abs(occupied - cell).max(axis=1) == gap
        known = occupied[beside]
        steps = apply_homography(model, np.array(cell, float)) - apply_homography(model, known)
        expected = (at[index[beside]] + steps).mean(axis=0)
        deviation = np.where(free, _to_steps(model, np.array(cell, float), at - expected) / threshold, np.inf)
        best = int(np.argmin(deviation))
        if deviation[best] < 1:
            predicted.append((float(deviation[best]), best, cell))
    return predicted


def _list_free_cells(cells: Cells, size: tuple[int, int], gap: int) -> list[tuple[int, int]]:
    """Return the free cells ``gap`` from the nearest occupied one that keep the grid within ``size``, in order."""
    occupied = np.array(list(cells.values()))
    low, high = occupied.min(axis=0) - gap, occupied.max(axis=0) + gap
    around = [(c, r) for c in range(low[0], high[0] + 1) for r in range(low[1], high[1] + 1)]
    distance = np.abs(occupied - np.array(around)[:, None]).max(axis=2).min(axis=1)
    return _select_fitting(cells, [around[i] for i in np.flatnonzero(distance == gap)], size)


def _select_fitting(
    cells: Cells, others: list[tuple[int, int]], size: tuple[int, int]
) -> list[tuple[int, int]]:
    """Return those of other cells with which the cells span at most ``size`` columns and rows, or turned."""
    columns, rows = zip(*cells.values(), strict=True)
    left, right, top, bottom = min(columns), max(columns), min(rows), max(rows)
    fitting: list[tuple[int, int]] = []
    for column, row in others:
        wide = max(right, column) - min(left, column) + 1
        high = max(bottom, row) - min(top, row) + 1
        if (wide <= size[0] and high <= size[1]) or (wide <= size[1] and high <= size[0]):
            fitting.append((column, row))
    return fitting


def _spans_plane(cells: Cells) -> bool:
    """Return whether the cells span both directions."""
    occupied = np.array(list(cells.values()), float)
    return bool(np.linalg.matrix_rank(occupied - occupied.mean(axis=0)) == 2)


def _measure_deviations(markers: MarkerDetections, cells: Cells) -> NDArray[np.float64]:
    """Return the (n,) distance of each detection from the homography fitted to all, in interval thresholds."""
    index, occupied = np.array(list(cells)), np.array(list(cells.values()))
    model = fit_homography(occupied, markers.center_px[index])
    occupied = occupied.astype(float)
    offset = markers.center_px[index] - apply_homography(model, occupied)
    return _to_steps(model, occupied.mean(axis=0), offset) / _interval_thresholds(markers)[index]


def _interval_thresholds(markers: MarkerDetections) -> NDArray[np.float64]:
    """Return the (N,) interval threshold of each detection, in steps."""
    return _INTERVAL + _INTERVAL_OF_DISC * markers.confidence


def _to_steps(
    model: NDArray[np.float64], cell: NDArray[np.float64], offsets_px: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the (n,) lengths of offsets (n, 2) px around a cell, in steps along and across."""
    ends = apply_homography(model, cell + np.array([[0.5, 0], [-0.5, 0], [0, 0.5], [0, -0.5]]))
    steps = np.stack([ends[0] - ends[1], ends[2] - ends[3]], axis=1)
    if abs(np.linalg.det(steps)) < 1e-6:
        return np.full(len(offsets_px), np.inf)
    return np.linalg.norm(np.linalg.solve(steps, offsets_px.T), axis=0)
