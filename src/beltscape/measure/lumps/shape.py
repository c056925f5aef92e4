"""What is measured of each lump: its outline from above, how much of it others hide, its size, its volume.

Size is the sieve that it just passes, for which the intermediate axis stands (Krumbein 1941, J. Sediment. Petrol.
11(2)). Lumps come to rest on their flat side, so from above one sees the longest and the intermediate axis: the
sides of the smallest rectangle about the outline, as Thurley (2011, 10.1016/j.jprocont.2010.11.011) sizes rocks on
a belt. What neighbours hide makes the rectangle too small: the size is then drawn towards what is typical among the
frame's lumps.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.pose import Pose
from beltscape.measure.lumps.raster import Raster
from beltscape.measure.lumps.rims import Rims, rims_of

OCCLUDED = 0.15
"""Hidden share of the outline from which on a lump counts as occluded."""
_HIDDEN = np.array([0.0, 0.12, 0.20, 0.27, 0.42, 0.60])
"""Shares of the outline for which the tables below hold, linear between them: log(size/typical) = offset +
slope·log(width/typical), from simulated heaps. What is seen whole is taken as it is; the more is hidden, the
larger is the rest, and the more the typical width of the frame's lumps tells."""
_OFFSET = np.array([0.03, 0.03, 0.07, 0.15, 0.32, 0.42])
_SLOPE = np.array([1.0, 1.0, 0.9, 0.8, 0.7, 0.7])
_SPREAD = np.array([0.08, 0.09, 0.15, 0.25, 0.33, 0.35])
"""Standard deviation of the logarithm."""
_BULK = 0.40
"""Volume over size cubed, times the outline's area over its width squared to the power of 1.5."""
_FOOT = 0.2
"""Of the visible heights, ascending: the level that the silhouette is laid on."""
_OUTLINE_CELLS = 0.6
"""One standard deviation of the width from where the outline was drawn."""


@dataclass(frozen=True, slots=True)
class Lump:
    """One lump of the top layer; lengths along and across the up direction of its frame."""

    number: int
    """Its value in the label picture, from 1."""
    center_mm: tuple[float, float, float]
    """Middle of its visible surface, in the belt frame where the empty belt is known, else in the core's."""
    size_mm: float
    """Estimated sieve size."""
    sigma_mm: float
    """One standard deviation of it."""
    width_mm: float
    """Short side of the smallest rectangle about what is visible, from above."""
    length_mm: float
    """Its long side."""
    area_mm2: float
    """Visible area, from above."""
    height_mm: float
    """From the lowest to the highest of what is visible."""
    volume_mm3: float
    """Estimated from size and outline."""
    hidden: float
    """Share of its outline, 0..1, where something nearer cuts it off."""
    occluded: bool
    """Whether that is more than `OCCLUDED`."""
    cut: bool
    """Whether it goes on beyond the frame or what was measured of it."""
    outline: float
    """Mean probability that its outline is one, 0..1."""


def shapes(
    raster: Raster, labels: NDArray[np.int64], outline: NDArray[np.float32], up_from_core: Pose
) -> tuple[Lump, ...]:
    """Measure the lumps of a label picture (R, C); ``up_from_core`` leads into a frame whose z is upwards."""
    count = int(labels.max())
    rims = rims_of(raster, labels, outline, count)
    order = np.argsort(labels, axis=None, kind="stable")
    ends = np.searchsorted(labels.ravel()[order], np.arange(count + 2))
    points = up_from_core.apply(raster.points_mm).reshape(-1, 3)
    rays = np.concatenate([raster.rays, np.ones((*labels.shape, 1))], axis=-1).reshape(-1, 3)
    rays = rays @ up_from_core.rotation.T
    found = []
    for number in range(1, count + 1):
        cells = order[ends[number] : ends[number + 1]]
        found.append(_from_above(points[cells], rays[cells], up_from_core.translation_mm, raster.cell_rad))
    area = np.array([seen.area_mm2 for seen in found])
    typical = float(np.sum([seen.width_mm for seen in found] * area) / max(area.sum(), 1e-9))
    return tuple(_measured(number, seen, rims, typical) for number, seen in enumerate(found, 1))


@dataclass(frozen=True, slots=True)
class _Seen:
    """A lump's visible part."""

    center_mm: tuple[float, float, float]
    width_mm: float
    length_mm: float
    area_mm2: float
    height_mm: float
    cell_mm: float


def _from_above(
    points: NDArray[np.float64], rays: NDArray[np.float64], eye_mm: NDArray[np.float64], cell_rad: float
) -> _Seen:
    """Outline and area from points (n, 3) and the rays (n, 3) to them.

    The silhouette is laid on the level near the lump's foot, where a round lump's outline is: the depths right
    at the outline may be those of what lies below, and off the axis that would move it sideways.
    """
    x, y, _ = np.median(points, axis=0)
    low, foot, top, high = np.quantile(points[:, 2], [0.02, _FOOT, 0.5, 0.98])
    distance = (foot - eye_mm[2]) / rays[:, 2]
    level = eye_mm[:2] + distance[:, None] * rays[:, :2]
    cell = float(np.median(distance)) * cell_rad
    _, sides, _ = cv2.minAreaRect((level - [x, y]).astype(np.float32))
    area = float(((distance * cell_rad) ** 2 / np.abs(rays[:, 2])).sum())
    # from the outermost cells' middles to their rims, less what the raster adds: at a step it keeps the upper surface
    width, length = min(sides) + 0.5 * cell, max(sides) + 0.5 * cell
    return _Seen((float(x), float(y), float(top)), width, length, area, float(high - low), cell)


def _measured(number: int, seen: _Seen, rims: Rims, typical_mm: float) -> Lump:
    """A lump among others of a typical width (their mean by area)."""
    length = max(rims.length[number], 1)
    hidden = float(rims.hidden[number] / length)
    offset, slope, spread = (float(np.interp(hidden, _HIDDEN, table)) for table in (_OFFSET, _SLOPE, _SPREAD))
    size = typical_mm * np.exp(offset) * (seen.width_mm / typical_mm) ** slope
    volume = _BULK * size**3 * (seen.area_mm2 / seen.width_mm**2) ** 1.5
    return Lump(
        number=number,
        center_mm=seen.center_mm,
        size_mm=float(size),
        sigma_mm=float(np.hypot(spread * size, _OUTLINE_CELLS * seen.cell_mm)),
        width_mm=seen.width_mm,
        length_mm=seen.length_mm,
        area_mm2=seen.area_mm2,
        height_mm=seen.height_mm,
        volume_mm3=float(volume),
        hidden=hidden,
        occluded=hidden > OCCLUDED,
        cut=bool(rims.open[number]),
        outline=float(rims.strength[number] / length),
    )
