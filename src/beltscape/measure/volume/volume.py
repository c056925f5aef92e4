"""The volume between a loaded belt and the empty one, and the load's centre, fill level and highest point.

Its standard uncertainty is combined from its contributions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.arguments import require_depth_of
from beltscape.core.depth import DepthMap
from beltscape.core.display import Displayed
from beltscape.core.empty_belt import Belt
from beltscape.core.geometry.camera import Camera
from beltscape.core.height_map import BeltProfile, HeightMap
from beltscape.measure.holes import Filled, fill_holes
from beltscape.measure.surface import Grid, average_blocks
from beltscape.measure.volume.load import (
    Box,
    IntegrationWeights,
    Load,
    average_load,
    compute_capacity_mm2,
    compute_centroid_mm,
    compute_load,
    compute_profiles,
    find_belt_middle,
    select_box,
)
from beltscape.measure.volume.settings import VolumeSettings

STEP_SLOPE = float(np.tan(np.deg2rad(60.0)))
"""A surface steeper than this slope is a step."""
EDGE_PX = 0.1
"""σ of the position of steps, in pixels, common to all: a matcher's bias at edges is the same at all of them."""
_COMMON_SHARE = 0.2
"""Share of the holes' σ that is common to all holes, because one network filled them all and occluded parts are
alike; set on captures that the networks were not trained on."""
_PATCH_CELLS = 8
"""Errors within a hole are correlated only within blocks of this side, since the holes of a heap are connected."""


@dataclass(frozen=True, slots=True)
class VolumeSigma:
    """Contributions to a volume's uncertainty, one standard deviation each, mm³."""

    noise_mm3: float
    """Noise of the loaded depth map, correlated over patches as large as on the empty belt."""
    belt_mm3: float
    """Uncertainty of the empty belt's cross-section and deviation."""
    holes_mm3: float
    """Uncertainty of the interpolated cells: fully correlated within a hole's block, a share common to all."""
    edges_mm3: float
    """The vertical area of all steps times a tenth of a pixel, common to the whole box."""
    drift_mm3: float
    """Slow errors of the depth map on the empty belt and of cameras that moved, common to the whole box."""
    scale_mm3: float = 0.0
    """The size of the calibration board, by its certificate: three times its relative σ, for lengths in all three
    directions are measured by it."""
    unseen_mm3: float = 0.0
    """What the load may carry where nothing bounds it: the heights of the box that are extrapolated, and beside a box
    that covers only part of the belt's width those at its sides."""

    @property
    def total_mm3(self) -> float:
        """Return the root of the sum of squares."""
        parts = (
            self.noise_mm3,
            self.belt_mm3,
            self.holes_mm3,
            self.edges_mm3,
            self.drift_mm3,
            self.scale_mm3,
            self.unseen_mm3,
        )
        return float(np.sqrt(sum(part**2 for part in parts)))


def compute_volume_sigma(
    load: Load,
    filled: Filled,
    weights: IntegrationWeights,
    belt: Belt,
    factor: NDArray[np.float64] | None = None,
) -> VolumeSigma:
    """Return the contributions to σ of the weighted integral of ``filled``.

    ``factor`` (Ny, Nx), where given, multiplies the weights, as for moments of the load.
    """
    grid = load.grid
    cell_mm = grid.cell_mm
    weight = np.outer(weights.along, weights.across)
    if factor is not None:
        weight = weight * factor
    patch_mm2 = (belt.correlation_px * cell_mm) ** 2
    patch_cells = max(patch_mm2 / cell_mm**2, 1.0)
    noise = np.sqrt(np.sum((weight * np.nan_to_num(load.noise_mm)) ** 2) * patch_cells)
    belt_sigma = _compute_belt_sigma(weight, belt.surface_sigma_mm(grid.x_mm, grid.y_mm), grid.x_mm, belt)
    holes = _compute_hole_sigma(weight * np.where(load.measured, 0.0, filled.sigma_mm), ~load.measured)
    # the narrow gaps between neighbouring points are holes too, with a smaller σ
    narrow = load.measured & filled.hole
    holes = np.hypot(holes, _compute_hole_sigma(weight * np.where(narrow, filled.sigma_mm, 0.0), narrow))
    edges = EDGE_PX * cell_mm * abs(_sum_step_area_mm2(filled, weights, cell_mm, factor))
    drift = belt.drift_mm * abs(float(weight.sum()))
    return VolumeSigma(float(noise), belt_sigma, float(holes), float(edges), float(drift))


def _compute_belt_sigma(
    weight: NDArray[np.float64], sigma_mm: NDArray[np.float64], x_mm: NDArray[np.float64], belt: Belt
) -> float:
    """Return σ of the belt's integral: fully correlated along each node of its section, independent across."""
    node = np.rint(np.interp(x_mm, belt.x_mm, np.arange(len(belt.x_mm)))).astype(np.intp)
    return float(np.sqrt(np.sum(np.bincount(node, (weight * sigma_mm).sum(axis=0)) ** 2)))


def _compute_hole_sigma(sigma_mm3: NDArray[np.float64], hole: NDArray[np.bool_]) -> float:
    """Return σ of a sum over holes: fully correlated within each block of a hole, with a share common to all."""
    label = np.zeros(hole.shape, np.int32)
    ndimage.label(hole, np.ones((3, 3)), output=label)
    rows, columns = int(hole.shape[0]), int(hole.shape[1])
    block = (np.arange(rows)[:, None] // _PATCH_CELLS) * (columns // _PATCH_CELLS + 1) + np.arange(columns)[
        None
    ] // _PATCH_CELLS
    own = np.unique(label[hole].astype(np.int64) * (block.max() + 1) + block[hole], return_inverse=True)[1]
    sums = np.bincount(own.ravel(), sigma_mm3[hole]) if hole.any() else np.zeros(1)
    return float(np.sqrt(np.sum(sums**2) * (1 - _COMMON_SHARE**2) + (_COMMON_SHARE * sums.sum()) ** 2))


def _sum_step_area_mm2(
    filled: Filled, weights: IntegrationWeights, cell_mm: float, factor: NDArray[np.float64] | None
) -> float:
    """Return the vertical area of the steps within the box, weighted by the factor."""
    own = np.ix_(weights.along > 0, weights.across > 0)
    inside = filled.value_mm[own]
    times = np.ones(inside.shape) if factor is None else factor[own]
    total = 0.0
    for axis in (0, 1):
        rise = np.abs(np.diff(inside, axis=axis))
        here = times[1:] if axis == 0 else times[:, 1:]
        total += float(np.sum(np.where(rise > STEP_SLOPE * cell_mm, rise * here, 0.0)))
    return cell_mm * total


_MIN_SIGNIFICANCE = 3.0
"""A volume below this multiple of its σ may be no load at all: it has no centre."""
_MIN_VIEW_SHARE = 0.5
"""Least share of the core's view that a belt is assumed to fill, where less of it was measured when empty."""
_MIN_WIDTH_SHARE = 0.5
"""A box chosen automatically covers this share of the belt's width, unless the frame is sparse: then the belt beside
it may be loaded like the box."""
_RIM_MM = 25.0
"""The load at a side of the box is the mean over this width, and what was measured shows in windows of this side: a
few lumps wide, narrow against the belt."""
_MIN_SEEN_SHARE = 0.5
"""Share of such a window that is measured where the load was seen; false depths beyond the light are scattered."""


@dataclass(frozen=True, slots=True)
class Centre:
    """Centre of gravity of a load of uniform density, in the belt frame."""

    position_mm: tuple[float, float, float]
    """x, y, z."""
    sigma_mm: tuple[float, float, float]
    """One standard deviation of each."""
    off_middle_mm: float
    """Distance in x from the belt's middle: the eccentricity of the load."""
    off_middle_sigma_mm: float
    """One standard deviation of ``off_middle_mm``."""


@dataclass(frozen=True, slots=True)
class Fullness:
    """Fill level of the belt."""

    area_mm2: float
    """Mean cross-section of the load in the box."""
    capacity_mm2: float
    """Cross-section of the fully loaded belt; see `compute_capacity_mm2`."""
    level: float
    """``area_mm2`` over ``capacity_mm2``; NaN where the belt's shape holds no load."""
    whole_belt: bool
    """Whether both edges of the belt were found; else the capacity is that of the visible part."""


@dataclass(frozen=True, slots=True)
class Summit:
    """The highest measured cell of the load in the box."""

    height_mm: float
    """Height above the empty belt, as the mean over a cell of the height map."""
    sigma_mm: float
    """One standard deviation of ``height_mm``."""
    position_mm: tuple[float, float]
    """x, y."""


@dataclass(frozen=True, slots=True, eq=False)
class Volume(Displayed):
    """The load on the belt within a box of the belt frame."""

    volume_mm3: float
    """Integral over the box of loaded minus empty height, vertical in the belt frame; overhang counts as solid."""
    sigma_mm3: float
    """One standard deviation of the volume."""
    causes: VolumeSigma
    """The contributions to ``sigma_mm3``."""
    coverage: float
    """Share of the box in which the load's surface was measured, 0..1; the rest is interpolated."""
    across_mm: tuple[float, float]
    """The box in x."""
    along_mm: tuple[float, float]
    """The box in y."""
    load: HeightMap
    """Load over the empty belt, holes filled."""
    interpolated: NDArray[np.bool_]
    """(Ny, Nx) whether a cell of ``load`` was mostly not measured."""
    belt: Belt
    """The empty belt."""
    profiles: list[BeltProfile]
    """Cross-sections, each the mean over its stretch of belt; area times length adds up to the volume."""
    y_mm: NDArray[np.float64]
    """(N,) positions along the belt, a pixel apart."""
    area_mm2: NDArray[np.float64]
    """(N,) cross-section of the load at ``y_mm``, within the box's sides in x."""
    centre: Centre | None
    """Centre of gravity; None where there is hardly any load."""
    fullness: Fullness
    """Fill level relative to the belt's capacity."""
    summit: Summit | None
    """None where nothing was measured in the box."""

    @property
    def height_map(self) -> HeightMap:
        """The load's height above the empty belt: the same as ``load``."""
        return self.load

    def __repr__(self) -> str:
        litres, sigma = self.volume_mm3 * 1e-6, self.sigma_mm3 * 1e-6
        return f"Volume({litres:.3f} ± {sigma:.3f} l, {self.coverage:.1%} measured)"


def measure_volume(
    loaded: DepthMap,
    belt: Belt,
    camera: Camera,
    settings: VolumeSettings,
    *,
    across_mm: tuple[float, float] | None,
    along_mm: tuple[float, float] | None,
    scale_sigma: float = 0.0,
) -> Volume:
    """Measure the volume of the load within a box of the belt frame.

    ``scale_sigma`` is the relative standard deviation of the rig's lengths (`Rig.scale_sigma`).
    Without ``across_mm`` the box takes the belt's measured width, without ``along_mm`` the stretch in which the
    load is well measured. Heights below the empty belt count as negative: clipping them would bias the volume by
    the noise.

    Raises
    ------
    InputError
        if the depth map is not the camera's size, or the box is empty or far larger than the measured area.
    MeasureError
        if nothing was measured in the box.
    """
    require_depth_of(camera, loaded, "loaded belt")
    # the pixel size on the empty belt, not on the load: the grid is the same for every frame
    pixel_mm = float(belt.belt_from_core.inverse().translation_mm[2]) / float(camera.focal_px.mean())
    block_cells = 3 if settings.cell_mm is None else max(1, round(settings.cell_mm / pixel_mm))
    load, box = _place_box(loaded, belt, camera, pixel_mm, across_mm, along_mm)
    narrow = load.measured & ~np.isfinite(load.height_mm)
    filled = fill_holes(load.height_mm, load.sigma_mm, narrow, pixel_mm, load.ray_slope)
    weights = box.integration_weights(load.grid)
    area = filled.value_mm @ weights.across
    total = float(weights.along @ area)
    # a systematic error of all pixels of the loaded frame adds to the belt's slow errors
    belt_with_systematic = replace(belt, drift_mm=float(np.hypot(belt.drift_mm, loaded.systematic_mm)))
    causes = compute_volume_sigma(load, filled, weights, belt_with_systematic)
    causes = replace(causes, scale_mm3=3 * scale_sigma * abs(total))
    unseen = _compute_extrapolated_mm3(load, filled, weights)
    if across_mm is None:
        unseen += _compute_beside_mm3(weights.along @ filled.value_mm, load.grid.x_mm, box, belt, camera)
    causes = replace(causes, unseen_mm3=unseen)
    heights = average_load(load, filled, block_cells)
    interpolated = average_blocks(~load.measured, block_cells) > 0.5
    has_load = total > _MIN_SIGNIFICANCE * causes.total_mm3
    return Volume(
        volume_mm3=total,
        sigma_mm3=causes.total_mm3,
        causes=causes,
        coverage=weights.share(load.measured),
        across_mm=box.across_mm,
        along_mm=box.along_mm,
        load=heights,
        interpolated=interpolated,
        belt=belt,
        profiles=compute_profiles(filled.value_mm, load.measured, load.grid, box, settings.profile_every_mm),
        y_mm=load.grid.y_mm,
        area_mm2=area,
        centre=_compute_centre(load, filled, weights, belt, total) if has_load else None,
        fullness=_compute_fullness(belt, total / (box.along_mm[1] - box.along_mm[0]), settings),
        summit=_find_summit(heights, interpolated, box),
    )


def _place_box(
    loaded: DepthMap,
    belt: Belt,
    camera: Camera,
    pixel_mm: float,
    across_mm: tuple[float, float] | None,
    along_mm: tuple[float, float] | None,
) -> tuple[Load, Box]:
    """Return the load on a grid over the belt and the given sides, and the box in which it is integrated."""
    view = Box(belt.across_mm, belt.along_mm)
    whole = view if across_mm is None and along_mm is None else view.enclose(across_mm, along_mm)
    load = compute_load(loaded, camera, belt, Grid.over(whole.across_mm, whole.along_mm, pixel_mm))
    return load, select_box(load.measured, load.grid, across_mm, along_mm)


def _compute_extrapolated_mm3(load: Load, filled: Filled, weights: IntegrationWeights) -> float:
    """Return the volume of the cells outside what was measured: no measured cells bound them in row or column.

    So the box reaches beyond the view or the light. The load may go on there as high as the same part of the belt's
    width is on average, or as filled, or it may end.
    """
    side = max(3, round(_RIM_MM / load.grid.cell_mm))
    seen = ndimage.uniform_filter(load.measured.astype(np.float32), side, mode="nearest") >= _MIN_SEEN_SHARE
    bounded = np.zeros(seen.shape, np.bool_)
    for axis in (0, 1):
        before = np.maximum.accumulate(seen, axis=axis)
        after = np.flip(np.maximum.accumulate(np.flip(seen, axis), axis=axis), axis)
        bounded |= before & after
    on_average = np.abs(np.where(load.measured, filled.value_mm, 0.0).sum(axis=0)) / np.maximum(
        load.measured.sum(axis=0), 1
    )
    heights = np.where(bounded | load.measured, 0.0, np.maximum(np.abs(filled.value_mm), on_average))
    return float(weights.along @ heights @ weights.across)


def _compute_beside_mm3(
    area_mm2: NDArray[np.float64], x_mm: NDArray[np.float64], box: Box, belt: Belt, camera: Camera
) -> float:
    """Return the volume beside a box narrower than the belt, were the load as high there as at the box's sides.

    ``area_mm2`` (Nx,) is the load's longitudinal section at each column ``x_mm``. A heap that rises out of the view
    ends at the view and not at the belt's edge: what it carries beyond shows in its height at the box's sides. Beside
    a box of a sparse frame the belt may be loaded like the box itself.
    """
    distance = float(belt.belt_from_core.inverse().translation_mm[2])
    view = distance * camera.size_px[0] / float(camera.focal_px[0])
    low, high = box.across_mm
    left, right = belt.across_mm
    width = max(right - left, _MIN_VIEW_SHARE * view)
    beyond = 0.5 * (width - (right - left))
    rim = min(_RIM_MM, 0.5 * (high - low))
    at_sides = 0.0
    for gap, inside in ((low - left, x_mm < low + rim), (right - high, x_mm > high - rim)):
        section = area_mm2[inside & (x_mm >= low) & (x_mm <= high)]
        at_sides += max(gap + beyond, 0.0) * abs(float(section.mean()))
    if high - low >= _MIN_WIDTH_SHARE * width:
        return at_sides
    within = abs(float(area_mm2[(x_mm >= low) & (x_mm <= high)].mean()))
    return max(at_sides, (width - (high - low)) * within)


def _compute_centre(
    load: Load, filled: Filled, weights: IntegrationWeights, belt: Belt, total_mm3: float
) -> Centre:
    """Return the load's centre of gravity; its σ is that of a volume whose heights are weighted by their levers."""
    grid = load.grid
    weight = np.outer(weights.along, weights.across)
    bottom = belt.surface_mm(grid.x_mm, grid.y_mm)
    x = np.broadcast_to(grid.x_mm[None], grid.shape)
    y = np.broadcast_to(grid.y_mm[:, None], grid.shape)
    position = [
        compute_centroid_mm(weight, filled.value_mm, part) for part in (x, y, bottom + filled.value_mm / 2)
    ]
    # a change of a column's top moves the centre's z by the top's height over the centre
    levers = (x - position[0], y - position[1], bottom + filled.value_mm - position[2])
    sigma = [
        compute_volume_sigma(load, filled, weights, belt, lever).total_mm3 / total_mm3 for lever in levers
    ]
    middle, middle_sigma = find_belt_middle(belt)
    return Centre(
        (position[0], position[1], position[2]),
        (sigma[0], sigma[1], sigma[2]),
        position[0] - middle,
        float(np.hypot(sigma[0], middle_sigma)),
    )


def _compute_fullness(belt: Belt, area_mm2: float, settings: VolumeSettings) -> Fullness:
    capacity = compute_capacity_mm2(belt, float(np.deg2rad(settings.surcharge_deg)))
    edges = belt.edges
    whole = edges is not None and bool(np.isfinite(edges.left_mm) and np.isfinite(edges.right_mm))
    return Fullness(area_mm2, capacity, area_mm2 / capacity if capacity > 0 else np.nan, whole)


def _find_summit(load: HeightMap, interpolated: NDArray[np.bool_], box: Box) -> Summit | None:
    inside = (load.y_mm >= box.along_mm[0]) & (load.y_mm <= box.along_mm[1])
    inside = inside[:, None] & ((load.x_mm >= box.across_mm[0]) & (load.x_mm <= box.across_mm[1]))[None]
    inside &= ~interpolated
    if not inside.any():
        return None
    row, column = np.unravel_index(int(np.argmax(np.where(inside, load.height_mm, -np.inf))), inside.shape)
    return Summit(
        float(load.height_mm[row, column]),
        float(load.sigma_mm[row, column]),
        (float(load.x_mm[column]), float(load.y_mm[row])),
    )
