"""Size, volume and occlusion of each lump, from the part of its outline that is visible from above.

Size is the aperture of the sieve that a lump just passes, which its intermediate axis approximates (Krumbein 1941,
J. Sediment. Petrol. 11(2)). Lumps rest on their flat side, so the longest and the intermediate axis are visible from
above: they are the sides of the smallest rectangle around the outline, as in Thurley (2011,
10.1016/j.jprocont.2010.11.011). Occlusion by neighbours makes the rectangle too small: the size is then shrunk
towards the typical size of the frame's lumps.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.pose import Pose
from beltscape.measure.lumps.raster import Raster
from beltscape.measure.lumps.rims import Rims, measure_rims

OCCLUDED = 0.15
"""A lump counts as occluded above this hidden share of its outline."""
_HIDDEN = np.array([0.0, 0.12, 0.20, 0.27, 0.42, 0.60])
"""Hidden shares of the tables below, interpolated linearly: log(size/typical) = offset + slope·log(width/typical),
fitted to simulated heaps. A fully visible lump keeps its width; the more is hidden, the larger the size becomes
relative to the width, and the more the typical width of the frame's lumps counts."""
_OFFSET = np.array([0.03, 0.03, 0.07, 0.15, 0.32, 0.42])
"""Offset by hidden share."""
_SLOPE = np.array([1.0, 1.0, 0.9, 0.8, 0.7, 0.7])
"""Slope by hidden share."""
_SPREAD = np.array([0.08, 0.09, 0.15, 0.25, 0.33, 0.35])
"""Standard deviation of the logarithm."""
_BULK = 0.40
"""Factor of the volume: volume = factor · size³ · (outline's area / width²)^1.5."""
_FOOT = 0.2
"""Quantile of the visible heights at which the silhouette is measured."""
_OUTLINE_CELLS = 0.6
"""One standard deviation of the width due to the position of the outline, in cells."""


@dataclass(frozen=True, slots=True)
class Lump:
    """One lump of the top layer; lengths along and across the up direction of its frame."""

    number: int
    """Value in the label image, from 1."""
    center_mm: tuple[float, float, float]
    """Centre of the visible surface, in the belt frame if the empty belt is given, else in the core's."""
    size_mm: float
    """Estimated sieve size."""
    sigma_mm: float
    """One standard deviation of the size."""
    width_mm: float
    """Short side of the smallest rectangle around the visible part, from above."""
    length_mm: float
    """Long side of that rectangle."""
    area_mm2: float
    """Visible area, from above."""
    height_mm: float
    """Height difference between the lowest and the highest visible point."""
    volume_mm3: float
    """Volume estimated from size and outline."""
    hidden: float
    """Share of the outline, 0..1, that a nearer surface occludes."""
    occluded: bool
    """Whether ``hidden`` exceeds `OCCLUDED`."""
    cut: bool
    """Whether the lump touches the border of the frame or of the measured area."""
    outline: float
    """Mean probability of an outline along the rim, 0..1."""


def measure_shapes(
    raster: Raster, labels: NDArray[np.int64], outline: NDArray[np.float32], up_from_core: Pose
) -> tuple[Lump, ...]:
    """Measure the lumps of a label image (R, C); ``up_from_core`` transforms into a frame whose z points upwards."""
    count = int(labels.max())
    rims = measure_rims(raster, labels, outline, count)
    order = np.argsort(labels, axis=None, kind="stable")
    ends = np.searchsorted(labels.ravel()[order], np.arange(count + 2))
    points = up_from_core.apply(raster.points_mm).reshape(-1, 3)
    rays = np.concatenate([raster.rays, np.ones((*labels.shape, 1))], axis=-1).reshape(-1, 3)
    rays = rays @ up_from_core.rotation.T
    parts: list[_VisiblePart] = []
    for number in range(1, count + 1):
        cells = order[ends[number] : ends[number + 1]]
        parts.append(
            _measure_visible_part(points[cells], rays[cells], up_from_core.translation_mm, raster.cell_rad)
        )
    area = np.array([part.area_mm2 for part in parts])
    typical = float(np.sum([part.width_mm for part in parts] * area) / max(area.sum(), 1e-9))
    return tuple(_estimate_lump(number, part, rims, typical) for number, part in enumerate(parts, 1))


@dataclass(frozen=True, slots=True)
class _VisiblePart:
    """The visible part of a lump."""

    center_mm: tuple[float, float, float]
    width_mm: float
    length_mm: float
    area_mm2: float
    height_mm: float
    cell_mm: float


def _measure_visible_part(
    points: NDArray[np.float64], rays: NDArray[np.float64], eye_mm: NDArray[np.float64], cell_rad: float
) -> _VisiblePart:
    """Measure outline and area from points (n, 3) and the rays (n, 3) to them.

    The silhouette is projected onto a level near the lump's foot, where a round lump's outline lies. The depths at
    the outline itself may be those of the surface below, which would displace it laterally off the optical axis.
    """
    x, y, _ = np.median(points, axis=0)
    low, foot, top, high = np.quantile(points[:, 2], [0.02, _FOOT, 0.5, 0.98])
    distance = (foot - eye_mm[2]) / rays[:, 2]
    level = eye_mm[:2] + distance[:, None] * rays[:, :2]
    cell = float(np.median(distance)) * cell_rad
    _, sides, _ = cv2.minAreaRect((level - [x, y]).astype(np.float32))
    area = float(((distance * cell_rad) ** 2 / np.abs(rays[:, 2])).sum())
    # add the outermost cells' halves, less what the raster adds: at a step it keeps the upper surface
    width, length = min(sides) + 0.5 * cell, max(sides) + 0.5 * cell
    return _VisiblePart((float(x), float(y), float(top)), width, length, area, float(high - low), cell)


def _estimate_lump(number: int, part: _VisiblePart, rims: Rims, typical_mm: float) -> Lump:
    """Estimate a lump from its visible part and the typical width of the frame's lumps (their mean by area)."""
    length = max(rims.length[number], 1)
    hidden = float(rims.hidden[number] / length)
    offset, slope, spread = (float(np.interp(hidden, _HIDDEN, table)) for table in (_OFFSET, _SLOPE, _SPREAD))
    size = typical_mm * np.exp(offset) * (part.width_mm / typical_mm) ** slope
    volume = _BULK * size**3 * (part.area_mm2 / part.width_mm**2) ** 1.5
    return Lump(
        number=number,
        center_mm=part.center_mm,
        size_mm=float(size),
        sigma_mm=float(np.hypot(spread * size, _OUTLINE_CELLS * part.cell_mm)),
        width_mm=part.width_mm,
        length_mm=part.length_mm,
        area_mm2=part.area_mm2,
        height_mm=part.height_mm,
        volume_mm3=float(volume),
        hidden=hidden,
        occluded=hidden > OCCLUDED,
        cut=bool(rims.open[number]),
        outline=float(rims.strength[number] / length),
    )
