"""Segmentation of the raster into lumps: watershed, merging, and rejection of ground and fines.

The watershed gives catchment basins and the crests between them; regions are merged across their weakest borders.
Their rims show the hidden share, the strength of the outline, and whether the frame cuts them.
"""

from __future__ import annotations

from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.learned.network import Network, compute_probability
from beltscape.learned.registry import load_network
from beltscape.measure.lumps.features import Raster, blur, compute_features

_NEIGHBOURS = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]


@dataclass(frozen=True, slots=True, eq=False)
class Borders:
    """Borders between neighbouring regions, first < second."""

    first: NDArray[np.int64]
    """(B,) region on one side."""
    second: NDArray[np.int64]
    """(B,) region on the other side."""
    sum: NDArray[np.float64]
    """(B,) the field summed along the border, at each pair of cells its higher value."""
    length: NDArray[np.int64]
    """(B,) number of pairs of neighbouring cells along the border."""


def find_basins(field: NDArray[np.float32], floor: float) -> NDArray[np.int64]:
    """Return basin numbers (R, C) from 0: each cell descends to its lowest neighbour until it reaches a minimum.

    Watershed by topographic distance, Meyer 1994, 10.1016/0165-1684(94)90060-4. Connected cells no higher than
    ``floor`` form one minimum.
    """
    rows, columns = field.shape
    index = np.arange(int(rows * columns)).reshape(rows, columns)
    around = np.pad(field, 1, constant_values=np.inf)
    lowest, to = field.copy(), index.copy()
    for down, right in _NEIGHBOURS:
        beside = around[1 + down : rows + 1 + down, 1 + right : columns + 1 + right]
        lower = beside < lowest
        lowest[lower] = beside[lower]
        to[lower] = index[lower] + (down * columns + right)
    pools, count = ndimage.label(field <= floor)
    first = np.full(count + 1, rows * columns, np.int64)
    np.minimum.at(first, pools.ravel(), index.ravel())
    to = np.where(pools > 0, first[pools], to).ravel()
    return _number_roots(to).reshape(rows, columns)


def _number_roots(parents: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number (n,), from 0, of the root that each of n nodes reaches by its parents."""
    while True:
        further = parents[parents]  # twice as far with each round
        if (further == parents).all():
            return np.unique(parents, return_inverse=True)[1]
        parents = further


def find_borders(regions: NDArray[np.int64], field: NDArray[np.float32]) -> Borders:
    """Return the borders of regions (R, C) numbered from 0, between four-neighbours."""
    number = int(regions.max()) + 1
    keys: list[NDArray[np.int64]] = []
    heights: list[NDArray[np.float32]] = []
    for one, two in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        a, b = regions[one], regions[two]
        apart = a != b
        keys.append(np.minimum(a[apart], b[apart]) * number + np.maximum(a[apart], b[apart]))
        heights.append(np.maximum(field[one], field[two])[apart])
    key, which = np.unique(np.concatenate(keys), return_inverse=True)
    total = cast("NDArray[np.float64]", np.bincount(which, np.concatenate(heights), len(key)))
    return Borders(key // number, key % number, total, np.bincount(which, minlength=len(key)))


def merge_regions(number: int, borders: Borders, limit: float) -> NDArray[np.int64]:
    """Return the new number of each region (number,), from 0, after merging across borders below the limit.

    The weakest border is merged first. A border's strength is its mean over its length, so the borders of merged
    regions are pooled (the boundary-mean hierarchy of Arbeláez et al. 2011, 10.1109/TPAMI.2010.161).
    """
    beside: list[dict[int, tuple[float, int]]] = [{} for _ in range(number)]
    queue: list[tuple[float, int, int]] = []
    columns = (borders.first, borders.second, borders.sum, borders.length)
    for a, b, total, length in zip(*(column.tolist() for column in columns), strict=True):
        beside[a][b] = beside[b][a] = (total, length)
        queue.append((total / length, a, b))
    heapify(queue)
    root = np.arange(number)
    while queue and queue[0][0] < limit:
        strength, a, b = heappop(queue)
        border = beside[a].get(b)
        if border is None or border[0] / border[1] != strength:
            continue  # merged or extended meanwhile
        keep, give = (a, b) if len(beside[a]) >= len(beside[b]) else (b, a)
        root[give] = keep
        del beside[keep][give], beside[give][keep]
        for other, (total, length) in beside[give].items():
            del beside[other][give]
            more = beside[keep].get(other, (0.0, 0))
            joint = (total + more[0], length + more[1])
            beside[keep][other] = beside[other][keep] = joint
            heappush(queue, (joint[0] / joint[1], min(keep, other), max(keep, other)))
        beside[give] = {}
    return _number_roots(root)


_STEP_CELLS = 1.0
"""A neighbour nearer by more than this, in widths of a cell, hides the region at the rim."""


@dataclass(frozen=True, slots=True, eq=False)
class Rims:
    """Sums over the rims of N + 1 regions, numbered from 0."""

    length: NDArray[np.float64]
    """(N + 1,) number of pairs of a cell inside and a cell outside."""
    hidden: NDArray[np.float64]
    """(N + 1,) number of these pairs whose outer cell is nearer to the camera."""
    strength: NDArray[np.float64]
    """(N + 1,) summed probability of an outline."""
    open: NDArray[np.bool_]
    """(N + 1,) whether the region touches the border of the frame or of the measured area."""

    @property
    def hidden_share(self) -> NDArray[np.float64]:
        """Return the hidden share of the rims (N + 1,), 0..1."""
        return self.hidden / np.maximum(self.length, 1)


def measure_rims(raster: Raster, labels: NDArray[np.int64], outline: NDArray[np.float32], count: int) -> Rims:
    """Measure the rims of regions (R, C) numbered 0 to ``count``, given the probability of an outline (R, C)."""
    length, hidden, strong = (np.zeros(count + 1) for _ in range(3))
    beyond = np.pad(raster.beyond, 1, constant_values=True)
    is_open = np.zeros(count + 1, bool)
    step = _STEP_CELLS * raster.depth_mm * raster.cell_rad
    for one, two in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        apart = labels[one] != labels[two]
        strength = np.maximum(outline[one], outline[two])[apart]
        for a, b in ((one, two), (two, one)):
            own = labels[a][apart]
            nearer = (raster.depth_mm[a] - raster.depth_mm[b] > step[a])[apart]
            length += np.bincount(own, minlength=count + 1)
            hidden += np.bincount(own, nearer, count + 1)
            strong += np.bincount(own, strength, count + 1)
    rows, columns = labels.shape
    for down, right in ((0, 1), (2, 1), (1, 0), (1, 2)):
        is_open[labels[beyond[down : down + rows, right : right + columns]]] = True
    return Rims(length, hidden, strong, is_open)


_OUTLINE_FLOOR = 0.03
"""Connected cells of a lower probability form one minimum, so that noise makes no basins."""
_RIM_CELLS = 10.0
"""Width of the rim along an outline, within which the probability is averaged."""
_MIN_PROBABILITY = 0.5
"""Least mean probability of a lump along its rim."""
_GROUND_HIDDEN, _CLEAR_PROBABILITY = 0.45, 0.65
"""Above the first hidden share a region is ground, unless the mean probability of a lump reaches the second."""
_MIN_MEASURED = 0.4
"""Least measured share of a lump."""
_BURIED_HIDDEN, _MIN_SOLIDITY = 0.6, 0.85
"""Above the first hidden share a region is ground, unless it fills the second share of its convex hull."""
_SPUR = 0.35
"""Parts of a lump narrower than this share of its largest inscribed disc are removed as spurs."""


@dataclass(frozen=True, slots=True, eq=False)
class Segmentation:
    """Lumps on a raster."""

    labels: NDArray[np.int64]
    """(R, C) number of the cell's lump, from 1; 0 outside lumps."""
    outline: NDArray[np.float32]
    """(R, C) probability of an outline."""
    count: int
    """Number of lumps."""


def segment_lumps(
    raster: Raster,
    split: float,
    smallest_px: float,
    *,
    allowed: NDArray[np.bool_] | None = None,
    network: Network | None = None,
) -> Segmentation:
    """Segment the raster along probable outlines, merge regions without a clear outline, and select the lumps.

    ``allowed`` (R, C) restricts lumps to cells above the empty belt, if that is given.
    """
    probabilities = predict_outlines(raster, network)
    outline = blur(np.ascontiguousarray(probabilities[..., 0]), 1.0)
    regions = find_basins(outline, _OUTLINE_FLOOR)
    regions = merge_regions(int(regions.max()) + 1, find_borders(regions, outline), split)[regions]
    usable = raster.measured if allowed is None else raster.measured & allowed
    hidden = measure_rims(raster, regions, outline, int(regions.max())).hidden_share
    keep = _lump_mask(regions, probabilities[..., 1], usable, hidden, smallest_px)
    number = cast("NDArray[np.int64]", np.cumsum(keep) * keep)
    labels = _remove_spurs(number[regions], hidden[keep])
    present, labels = np.unique(np.append(0, labels.ravel()), return_inverse=True)
    return Segmentation(labels[1:].reshape(regions.shape), outline, len(present) - 1)


def predict_outlines(raster: Raster, network: Network | None = None) -> NDArray[np.float32]:
    """Return probabilities (R, C, 2) float32 of an outline, and of a lump (against fines, belt and floor)."""
    network = network or load_network("lumps")
    logits = network.evaluate(compute_features(raster.height_px, raster.measured))
    return compute_probability(np.stack(logits, axis=-1))


def _remove_spurs(labels: NDArray[np.int64], hidden: NDArray[np.float64]) -> NDArray[np.int64]:
    """Open each lump by a disc, whose radius is a share of its largest inscribed disc, and keep its largest part.

    A lump whose ``hidden`` share is large and whose outline is not compact is dropped: it is the ground that is
    visible between lumps.
    """
    opened = np.zeros_like(labels)
    for number, box in enumerate(ndimage.find_objects(labels, len(hidden)), 1):
        if box is None:
            continue
        own = np.pad((labels[box] == number).astype(np.uint8), 1)
        inner_distance = cv2.distanceTransform(own, cv2.DIST_L2, 5)
        radius = _SPUR * float(inner_distance.max())
        outer_distance = cv2.distanceTransform((inner_distance < radius).astype(np.uint8), cv2.DIST_L2, 5)
        kept = ((outer_distance < radius) & (own > 0)).astype(np.uint8)
        _, parts, sizes, _ = cv2.connectedComponentsWithStats(kept, connectivity=4)
        largest = 1 + int(sizes[1:, cv2.CC_STAT_AREA].argmax())
        piece = parts == largest
        if hidden[number - 1] > _BURIED_HIDDEN and _compute_solidity(piece) < _MIN_SOLIDITY:
            continue
        opened[box][piece[1:-1, 1:-1]] = number
    return opened


def _compute_solidity(piece: NDArray[np.bool_]) -> float:
    """Return the area of a region over that of its convex hull."""
    corners = cv2.findNonZero(piece.astype(np.uint8))
    # the hull through the cells' centres, plus half a cell around it
    hull = cv2.convexHull(corners)
    return float(piece.sum()) / (cv2.contourArea(hull) + 0.5 * cv2.arcLength(hull, True) + 1)


def _lump_mask(
    regions: NDArray[np.int64],
    lump: NDArray[np.float32],
    usable: NDArray[np.bool_],
    hidden: NDArray[np.float64],
    smallest_px: float,
) -> NDArray[np.bool_]:
    """Return which regions are lumps (regions,).

    The probability of a lump is averaged over the cells near the rim, since a large flat top is ambiguous. A region
    hidden on all sides is ground, unless the probability of a lump is high over all its cells.
    """
    flat = regions.ravel()
    area = np.bincount(flat)
    inside = np.ones(regions.shape, np.uint8)
    for one, two in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        apart = regions[one] != regions[two]
        inside[one][apart] = 0
        inside[two][apart] = 0
    inside = np.pad(inside, 1)[1:-1, 1:-1]
    inner_distance = cv2.distanceTransform(inside, cv2.DIST_L2, 3)
    width = np.zeros(len(area))
    np.maximum.at(width, flat, inner_distance.ravel().astype(np.float64))
    rim = (inner_distance < _RIM_CELLS).ravel()
    number = np.bincount(flat, rim, len(area))
    rim_probability = np.bincount(flat, lump.ravel() * rim, len(area)) / np.maximum(number, 1)
    measured = np.bincount(flat, usable.ravel(), len(area)) / area
    wide = 2 * width + 1 >= 0.6 * smallest_px  # by the largest inscribed disc, narrower than an oval's width
    mean_probability = np.bincount(flat, lump.ravel(), len(area)) / area
    ground = (hidden > _GROUND_HIDDEN) & (mean_probability < _CLEAR_PROBABILITY)
    return (
        (rim_probability > _MIN_PROBABILITY)
        & ~ground
        & (measured > _MIN_MEASURED)
        & wide
        & (area >= 0.5 * smallest_px**2)
    )
