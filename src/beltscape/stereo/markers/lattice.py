"""Which candidates stand side by side: rows and columns found by interval thresholds, hidden ones left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.markers.markers import Markers

_NEAR, _NEAR_DISC = 0.2, 0.25
"""Interval threshold: how far from its expected place a neighbour may lie, in steps along and across: the first, and
the second for a perfect disc. Relief shifts it, and so does the perspective that few neighbours do not show yet; half
a step would be the next place."""
_STRAY = 1.5
"""Of the interval threshold: farther from the fitted grid than this is let go again."""
_STEP_RADII = (5.0, 32.0)
"""Distance of neighbours in radii: 11.5 and 18.5 in the pattern, foreshortened or half hidden."""
_LONGER = 3.0
"""Steps along and across differ by less than this factor: 1.6 in the pattern, more under a slanting view."""
_RADII = (0.3, 1.7)
"""Radius over the median of those in place: torn by relief, or nearer to the camera."""
_TURN_DEG = 50.0
"""Columns are sought within this angle of the image's u axis; which way is up is decided afterwards."""
_PARTNERS = 4
"""Nearest candidates to either side that are tried as neighbours."""
_TRIED = 16
"""Best seeds that are grown."""
_LEAST = 6
"""Fewer than this in place can be chance."""
_STIFFNESS = 0.5
"""Weight against perspective, per step of the grid: three points give an affine map, sixteen a homography."""

Cells = dict[int, tuple[int, int]]
"""Candidate → column, row."""


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Candidates in rows and columns; cell (0, 0) is the first row and column that holds one."""

    index: NDArray[np.int64]
    """(n,) which candidates."""
    cell: NDArray[np.int64]
    """(n, 2) column, row, from 0."""
    score: float
    """Sum of the candidates' confidence, less the more they stand off their place."""


def find_lattice(markers: Markers, columns: int = 4, rows: int = 4) -> Lattice | None:
    """The best part of a grid of at most so many columns and rows (or turned) among candidates, or None.

    Every candidate with a neighbour along and one across is a seed (RANSAC, exhaustive); the best ones are grown
    neighbour by neighbour. A place is expected from the neighbours already known plus the step that a projective
    model, fitted to all of them, takes there; so the grid may be seen under perspective and be shifted by relief.
    """
    best: Lattice | None = None
    for seed in _seeds(markers):
        if best is not None and len(best.index) == columns * rows:
            break
        grown = _grown(markers, seed, (columns, rows))
        if len(grown.index) >= _LEAST and (best is None or grown.score > best.score):
            best = grown
    return best


def projective(cells: NDArray[np.floating], points_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) homography cells (n, 2) → points (n, 2), n ≥ 3 not on a line; as affine as few points demand.

    Linear least squares of u (1 + g c + h r) = a c + b r + d about the means, in steps of the grid, with g and h
    held towards zero.
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


def placed(homography: NDArray[np.float64], cells: NDArray[np.floating]) -> NDArray[np.float64]:
    """(..., 2) points of cells (..., 2)."""
    mapped = cells @ homography[:, :2].T + homography[:, 2]
    return mapped[..., :2] / np.maximum(mapped[..., 2:], 1e-6)  # cells behind the horizon go far away


def _seeds(markers: Markers) -> list[Cells]:
    """A corner with its neighbours along and across, the most promising first."""
    seeds = _corners(markers)
    if not seeds:
        return []
    at = markers.center_px
    members = np.array([list(seed) for seed in seeds])
    signs = np.array([[seed[i][k] for i, k in zip(list(seed)[1:], (0, 1), strict=True)] for seed in seeds])
    along, across = np.moveaxis((at[members[:, 1:]] - at[members[:, :1]]) * signs[..., None], 1, 0)
    # farther out than two steps an affine guess is off by more than the threshold
    steps = np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 3)), axis=-1).reshape(-1, 2)
    cells = np.linalg.inv(np.stack([along, across], axis=-1)) @ np.swapaxes(at - at[members[:, :1]], 1, 2)
    off = np.linalg.norm(np.swapaxes(cells, 1, 2)[:, None] - steps[:, None], axis=-1)
    hits = np.clip(1 - (off / _reach(markers)) ** 2, 0, None) * (0.5 + markers.confidence)
    order = np.argsort(-hits.max(axis=2).sum(axis=1), kind="stable")[:_TRIED]
    return [seeds[i] for i in order]


def _corners(markers: Markers) -> list[Cells]:
    """Every candidate with a possible neighbour along (about ±u) and one across (about ±v)."""
    at, radius = markers.center_px, markers.radius_px
    step = at[None] - at[:, None]
    distance = np.linalg.norm(step, axis=-1)
    radii = distance / np.maximum(radius[:, None], radius)
    near = (radii > _STEP_RADII[0]) & (radii < _STEP_RADII[1])
    along, across = (np.abs(step[..., k]) > np.cos(np.deg2rad(_TURN_DEG)) * distance for k in (0, 1))
    seeds = []
    for corner in range(len(at)):
        for a in _nearest(distance[corner], near[corner] & along[corner]):
            for b in _nearest(distance[corner], near[corner] & across[corner]):
                (au, av), (bu, bv) = step[corner, a], step[corner, b]
                right, down = int(np.sign(au)), int(np.sign(bv))
                turned = (au * bv - av * bu) * right * down / (distance[corner, a] * distance[corner, b])
                if (
                    a != b
                    and turned > 0.5
                    and 1 / _LONGER < distance[corner, a] / distance[corner, b] < _LONGER
                ):
                    seeds.append({corner: (0, 0), int(a): (right, 0), int(b): (0, down)})
    return seeds


def _nearest(distance: NDArray[np.float64], allowed: NDArray[np.bool_]) -> NDArray[np.int64]:
    index = np.flatnonzero(allowed)
    return index[np.argsort(distance[index], kind="stable")[: 2 * _PARTNERS]]


def _grown(markers: Markers, seed: Cells, size: tuple[int, int]) -> Lattice:
    """A seed and all that stands in its rows and columns."""
    cells = _grow(markers, seed, size)
    off = _off(markers, cells)
    kept = {i: cell for (i, cell), stray in zip(cells.items(), off, strict=True) if stray < _STRAY}
    if _LEAST <= len(kept) < len(cells) and _plane(kept):
        cells = _grow(markers, kept, size)
        off = _off(markers, cells)
    index = np.array(list(cells), np.int64)
    cell = np.array(list(cells.values()), np.int64)
    weight = np.clip(1 - off**2, 0, None)
    return Lattice(index, cell - cell.min(axis=0), float((weight * (0.5 + markers.confidence[index])).sum()))


def _grow(markers: Markers, cells: Cells, size: tuple[int, int]) -> Cells:
    cells = dict(cells)
    span = max(size)
    while True:
        added = False
        for gap in range(1, span):  # the nearer the neighbour, the surer the place
            for _, index, cell in sorted(_offers(markers, cells, size, gap)):
                if (
                    index not in cells
                    and cell not in cells.values()
                    and _within({*cells.values(), cell}, size)
                ):
                    cells[index] = cell
                    added = True
            if added:
                break
        if not added:
            return cells


def _offers(
    markers: Markers, cells: Cells, size: tuple[int, int], gap: int
) -> list[tuple[float, int, tuple[int, int]]]:
    """Candidates near the expected place of a free cell ``gap`` from taken ones: how far off (0..1), which, cell."""
    index = np.array(list(cells))
    taken = np.array(list(cells.values()))
    model, at = projective(taken, markers.center_px[index]), markers.center_px
    reach = _reach(markers)
    relative = markers.radius_px / np.median(markers.radius_px[index])
    free = (relative > _RADII[0]) & (relative < _RADII[1])
    free[index] = False
    if not free.any():
        return []
    offers = []
    for cell in _beside(cells, size, gap):
        beside = np.abs(taken - cell).max(axis=1) == gap
        known = taken[beside]
        steps = placed(model, np.array(cell, float)) - placed(model, known)
        expected = (at[index[beside]] + steps).mean(axis=0)
        off = np.where(free, _steps(model, np.array(cell, float), at - expected) / reach, np.inf)
        best = int(np.argmin(off))
        if off[best] < 1:
            offers.append((float(off[best]), best, cell))
    return offers


def _beside(cells: Cells, size: tuple[int, int], gap: int) -> list[tuple[int, int]]:
    """Free cells ``gap`` from the nearest taken one that keep the grid small enough, in a fixed order."""
    taken = np.array(list(cells.values()))
    low, high = taken.min(axis=0) - gap, taken.max(axis=0) + gap
    around = [(c, r) for c in range(low[0], high[0] + 1) for r in range(low[1], high[1] + 1)]
    near = [cell for cell in around if np.abs(taken - cell).max(axis=1).min() == gap]
    return [cell for cell in near if _within({*cells.values(), cell}, size)]


def _within(cells: set[tuple[int, int]], size: tuple[int, int]) -> bool:
    columns, rows = (max(c[k] for c in cells) - min(c[k] for c in cells) + 1 for k in (0, 1))
    return (columns <= size[0] and rows <= size[1]) or (columns <= size[1] and rows <= size[0])


def _plane(cells: Cells) -> bool:
    """Whether cells span both directions."""
    taken = np.array(list(cells.values()), float)
    return bool(np.linalg.matrix_rank(taken - taken.mean(axis=0)) == 2)


def _off(markers: Markers, cells: Cells) -> NDArray[np.float64]:
    """(n,) distance of each from the model fitted to all, in interval thresholds."""
    index, taken = np.array(list(cells)), np.array(list(cells.values()))
    model = projective(taken, markers.center_px[index])
    taken = taken.astype(float)
    away = markers.center_px[index] - placed(model, taken)
    return _steps(model, taken.mean(axis=0), away) / _reach(markers)[index]


def _reach(markers: Markers) -> NDArray[np.float64]:
    """(N,) interval threshold of each candidate, in steps."""
    return _NEAR + _NEAR_DISC * markers.confidence


def _steps(
    model: NDArray[np.float64], cell: NDArray[np.float64], away_px: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n,) lengths of offsets (n, 2) px about a cell, in steps along and across."""
    ends = placed(model, cell + np.array([[0.5, 0], [-0.5, 0], [0, 0.5], [0, -0.5]]))
    steps = np.stack([ends[0] - ends[1], ends[2] - ends[3]], axis=1)
    if abs(np.linalg.det(steps)) < 1e-6:
        return np.full(len(away_px), np.inf)
    return np.linalg.norm(np.linalg.solve(steps, away_px.T), axis=0)
