"""Segmentation of the raster into lumps: watershed, merging, and rejection of ground and fines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.learned.network import Network, compute_probability
from beltscape.learned.registry import load_network
from beltscape.measure.lumps.basins import find_basins, find_borders
from beltscape.measure.lumps.features import compute_features
from beltscape.measure.lumps.merging import merge_regions
from beltscape.measure.lumps.raster import Raster, blur
from beltscape.measure.lumps.rims import measure_rims

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
