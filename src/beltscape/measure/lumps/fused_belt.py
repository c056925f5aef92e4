"""Lumps of the fused belt: every lump once, seen from above in heights over the empty belt.

A long belt is segmented in overlapping stretches, so that the memory is that of one stretch. A lump is taken from the
stretch in whose own part its middle lies; the overlap is as long as the belt is wide, so that no lump is cut by it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.errors import MeasureError
from beltscape.core.geometry.pose import Pose
from beltscape.core.height_map import HeightMap
from beltscape.measure.lumps.features import DISTANCE_MM, make_height_raster
from beltscape.measure.lumps.lumps import (
    FUSED_BELT,
    MAX_LUMPS,
    Lump,
    Lumps,
    make_lumps,
    mark_fines,
    measure_shapes,
)
from beltscape.measure.lumps.segment import segment_lumps
from beltscape.measure.lumps.settings import LumpSettings

_MEASURED_SHARE = 0.5
"""Share of a cell that some frame measured from which on the cell counts as measured, as in ``evaluate belt``."""
_LOAD_CELLS, _LOAD_SIGMAS = 2.0, 6.0
"""Height of the load over the empty belt, in cells and in median σ, from which on a cell can belong to a lump; as for
a frame."""


def measure_belt_lumps(
    heights: HeightMap, measured: NDArray[np.float64], settings: LumpSettings, counted_mm: tuple[float, float]
) -> Lumps:
    """Segment the lumps of a fused belt and measure them; ``measured`` (Ny, Nx) is the measured share of each cell.

    Belt outside ``counted_mm``, in s, was not in view across its whole width: lumps there are cut.

    Raises
    ------
    MeasureError
        With more lumps than the labels can number.
    """
    counted = (heights.y_mm >= counted_mm[0]) & (heights.y_mm <= counted_mm[1])
    height = np.where(counted[:, None], heights.height_mm, np.nan)
    is_measured = (measured >= _MEASURED_SHARE) & np.isfinite(height)
    sigma = heights.sigma_mm[is_measured]
    least_mm = max(
        _LOAD_CELLS * heights.cell_mm, _LOAD_SIGMAS * float(np.median(sigma)) if sigma.size else 0.0
    )
    found = _Found(np.zeros(height.shape, np.int64))
    for stretch in _split(*height.shape):
        rows = slice(stretch.first, stretch.end)
        part = replace(
            heights,
            height_mm=height[rows],
            sigma_mm=heights.sigma_mm[rows],
            origin_mm=(heights.origin_mm[0], float(heights.y_mm[stretch.first])),
        )
        _add_stretch(found, stretch, part, is_measured[rows], least_mm, settings)
    loaded = is_measured & (np.nan_to_num(height) > least_mm)
    labels, fines = mark_fines(found.labels, loaded)
    ends = heights.y_mm[is_measured.any(axis=1)]
    return make_lumps(
        tuple(found.lumps), labels.astype(np.uint16), FUSED_BELT, heights.cell_mm, settings,
        fines_share=fines if loaded.any() else np.nan, along_mm=float(np.ptp(ends)) if ends.size else 0.0,
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Stretch:
    """Rows that are segmented at once, and its own part of them: that of no other stretch."""

    first: int
    end: int
    own_first: int
    own_end: int


def _split(rows: int, columns: int) -> Iterator[_Stretch]:
    """Yield the stretches of a belt: three widths long, one of them shared with the next."""
    first = 0
    while True:
        end = first + 3 * columns
        is_last = end >= rows
        own_first = 0 if first == 0 else first + columns // 2
        yield _Stretch(first, min(end, rows), own_first, rows if is_last else end - columns + columns // 2)
        if is_last:
            return
        first = end - columns


@dataclass(slots=True)
class _Found:
    """Lumps of the stretches so far."""

    labels: NDArray[np.int64]
    """(Ny, Nx) number of the cell's lump, 0: none."""
    lumps: list[Lump] = field(default_factory=list[Lump])


def _add_stretch(
    found: _Found,
    stretch: _Stretch,
    heights: HeightMap,
    measured: NDArray[np.bool_],
    least_mm: float,
    settings: LumpSettings,
) -> None:
    """Add the lumps whose middle lies in the stretch's own part, or that reach into it and were not found before."""
    raster = make_height_raster(heights)
    if raster is None:
        return
    # the network sees the filled heights too, which gains rocks at their rims; but a lump of them alone is none
    load = measured & (heights.height_mm > least_mm)
    segmentation = segment_lumps(raster, settings.split, settings.smallest_px, allowed=load)
    middle = (float(heights.x_mm.mean()), float(heights.y_mm.mean()))
    up = Pose(np.diag([1.0, -1.0, -1.0]), np.array([*middle, DISTANCE_MM]))
    shapes = measure_shapes(raster, segmentation.labels, segmentation.outline, up)
    boxes = [box for box in ndimage.find_objects(segmentation.labels) if box is not None]  # one a number
    painted = found.labels[stretch.first : stretch.end]
    for lump in shapes:
        box = boxes[lump.number - 1]
        own = segmentation.labels[box] == lump.number
        row = stretch.first + round((lump.center_mm[1] - heights.origin_mm[1]) / heights.cell_mm)
        reaches = stretch.first + box[0].stop > stretch.own_first
        if lump.width_mm < settings.smallest_px * heights.cell_mm or row >= stretch.own_end or not reaches:
            continue
        if (painted[box][own] > 0).mean() > 0.5:
            continue  # the stretch before had it
        if len(found.lumps) == MAX_LUMPS:
            raise MeasureError(f"more than {MAX_LUMPS} lumps on the belt; measure the flow of a shorter run")
        number = len(found.lumps) + 1
        found.lumps.append(replace(lump, number=number))
        painted[box][own & (painted[box] == 0)] = number
