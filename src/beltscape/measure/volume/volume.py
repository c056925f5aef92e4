"""The volume between a loaded belt and the empty one, and the load's centre, fill level and highest point.

Its standard uncertainty is combined from its contributions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

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
from beltscape.measure.volume.uncertainty import (
    VolumeSigma,
    compute_beside_mm3,
    compute_extrapolated_mm3,
    compute_false_depths_mm3,
    compute_volume_sigma,
)

_MIN_SIGNIFICANCE = 3.0
"""A volume below this multiple of its σ may be no load at all: it has no centre."""


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
    causes = _combine_causes(loaded, load, filled, weights, belt, camera, box)
    unseen = compute_extrapolated_mm3(load, filled, weights)
    if across_mm is None:
        unseen += compute_beside_mm3(weights.along @ filled.value_mm, load.grid.x_mm, box, belt, camera)
    causes = replace(causes, unseen_mm3=unseen, scale_mm3=3 * scale_sigma * abs(total))
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


def _combine_causes(
    loaded: DepthMap,
    load: Load,
    filled: Filled,
    weights: IntegrationWeights,
    belt: Belt,
    camera: Camera,
    box: Box,
) -> VolumeSigma:
    """Return the contributions of the depth map, its holes and the empty belt."""
    # a systematic error of all pixels of the loaded frame adds to the belt's slow errors
    belt_with_systematic = replace(belt, drift_mm=float(np.hypot(belt.drift_mm, loaded.systematic_mm)))
    causes = compute_volume_sigma(load, filled, weights, belt_with_systematic)
    false_depths = compute_false_depths_mm3(loaded, camera, belt, box, load.grid.cell_mm)
    return replace(causes, false_depths_mm3=false_depths)


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
