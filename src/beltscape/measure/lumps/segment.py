"""Raster → which cell belongs to which lump."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.measure.lumps.basins import basins, borders
from beltscape.measure.lumps.merging import merged
from beltscape.measure.lumps.outlines import outlines
from beltscape.measure.lumps.raster import Raster, blur
from beltscape.measure.lumps.rims import rims_of
from beltscape.measure.network import Network

_FLOOR = 0.03
_RIM_CELLS = 10.0
_LUMP = 0.5
_GROUND, _SURELY = 0.45, 0.65
"""Hidden share from which on a region is ground unless its cells say lump so clearly."""
_LEAST_MEASURED = 0.4
_BURIED, _BULKY = 0.6, 0.85
"""Hidden share from which on a region is ground unless it fills so much of its convex hull."""
_SPUR = 0.35
"""What is narrower than this share of a lump's widest inner disc is a spur, no part of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Segmentation:
    """Lumps on a raster."""

    labels: NDArray[np.int64]
    """(R, C) number of the cell's lump, from 1; 0 where there is none."""
    outline: NDArray[np.float32]
    """(R, C) probability of an outline."""
    count: int
    """How many lumps."""


def segment(
    raster: Raster,
    split: float,
    smallest_px: float,
    *,
    allowed: NDArray[np.bool_] | None = None,
    network: Network | None = None,
) -> Segmentation:
    """Cut the raster along likely outlines, join what no clear outline parts, and keep what is a lump.

    ``allowed`` (R, C) is where lumps may be: over the empty belt, if that is known.
    """
    chances = outlines(raster, network)
    outline = blur(np.ascontiguousarray(chances[..., 0]), 1.0)
    regions = basins(outline, _FLOOR)
    regions = merged(int(regions.max()) + 1, borders(regions, outline), split)[regions]
    usable = raster.measured if allowed is None else raster.measured & allowed
    hidden = rims_of(raster, regions, outline, int(regions.max())).hidden_share
    keep = _lumps(regions, chances[..., 1], usable, hidden, smallest_px)
    number = np.cumsum(keep) * keep
    labels = _without_spurs(number[regions], hidden[keep])
    present, labels = np.unique(np.append(0, labels.ravel()), return_inverse=True)
    return Segmentation(labels[1:].reshape(regions.shape), outline, len(present) - 1)


def _without_spurs(labels: NDArray[np.int64], hidden: NDArray[np.float64]) -> NDArray[np.int64]:
    """Each lump opened by a disc, its radius a share of the largest that fits into the lump, and made one piece.

    What much is hidden of (shares of the rims of the lumps from 1) and is hollow then is dropped: lumps are bulky,
    the ground that shows between them is not.
    """
    tidy = np.zeros_like(labels)
    for number, box in enumerate(ndimage.find_objects(labels, len(hidden)), 1):
        if box is None:
            continue
        own = np.pad((labels[box] == number).astype(np.uint8), 1)
        deep = cv2.distanceTransform(own, cv2.DIST_L2, 5)
        radius = _SPUR * float(deep.max())
        away = cv2.distanceTransform((deep < radius).astype(np.uint8), cv2.DIST_L2, 5)
        kept = ((away < radius) & (own > 0)).astype(np.uint8)
        _, parts, sizes, _ = cv2.connectedComponentsWithStats(kept, connectivity=4)
        largest = 1 + int(sizes[1:, cv2.CC_STAT_AREA].argmax())
        piece = parts == largest
        if hidden[number - 1] > _BURIED and _solidity(piece) < _BULKY:
            continue
        tidy[box][piece[1:-1, 1:-1]] = number
    return tidy


def _solidity(piece: NDArray[np.bool_]) -> float:
    """Its area over its convex hull's."""
    corners = cv2.findNonZero(piece.astype(np.uint8))
    # the hull through the cells' middles, and half a cell about it
    hull = cv2.convexHull(corners)
    return float(piece.sum()) / (cv2.contourArea(hull) + 0.5 * cv2.arcLength(hull, True) + 1)


def _lumps(
    regions: NDArray[np.int64],
    lump: NDArray[np.float32],
    usable: NDArray[np.bool_],
    hidden: NDArray[np.float64],
    smallest_px: float,
) -> NDArray[np.bool_]:
    """(number of regions,) which are lumps.

    By the cells near their rims, for a large flat top tells nothing; but what all about it hides is the ground,
    unless all its cells look like a lump's.
    """
    flat = regions.ravel()
    area = np.bincount(flat)
    inside = np.ones(regions.shape, np.uint8)
    for one, two in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        apart = regions[one] != regions[two]
        inside[one][apart] = 0
        inside[two][apart] = 0
    inside = np.pad(inside, 1)[1:-1, 1:-1]
    deep = cv2.distanceTransform(inside, cv2.DIST_L2, 3)
    width = np.zeros(len(area))
    np.maximum.at(width, flat, deep.ravel().astype(np.float64))
    rim = (deep < _RIM_CELLS).ravel()
    number = np.bincount(flat, rim, len(area))
    chance = np.bincount(flat, lump.ravel() * rim, len(area)) / np.maximum(number, 1)
    measured = np.bincount(flat, usable.ravel(), len(area)) / area
    wide = 2 * width + 1 >= 0.6 * smallest_px  # the widest disc within; a narrow oval's is narrower than it
    whole = np.bincount(flat, lump.ravel(), len(area)) / area
    ground = (hidden > _GROUND) & (whole < _SURELY)
    return (chance > _LUMP) & ~ground & (measured > _LEAST_MEASURED) & wide & (area >= 0.5 * smallest_px**2)
