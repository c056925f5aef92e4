"""Volume between a loaded belt and the empty one, and how the load lies."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arguments import require_depth_of
from beltscape.core.belt import BeltProfile, HeightMap
from beltscape.core.belt_model import Belt
from beltscape.core.camera import Camera
from beltscape.core.depth import DepthMap
from beltscape.measure.box import Box, Weights, chosen_box, profiles
from beltscape.measure.capacity import belt_middle_mm, centre_mm, full_area_mm2
from beltscape.measure.holes.fill import Filled, fill_holes
from beltscape.measure.load import Load, gathered, load_over_belt
from beltscape.measure.settings import VolumeSettings
from beltscape.measure.surface import Grid, blocks_mean
from beltscape.measure.uncertainty import VolumeSigma, volume_sigma

_LEAST_SURE = 3.0
"""Where the volume is below so many σ, there may be no load: it has no centre."""


_LEAST_OF_VIEW = 0.5
"""Share of the core's view that a belt fills at least, where less of it was measured when it was empty."""
_LEAST_OF_WIDTH = 0.75
"""A box that was not asked for holds this share of the belt's width, unless the frame is sparse."""


@dataclass(frozen=True, slots=True)
class Centre:
    """Centre of gravity of an evenly dense load, in the belt frame."""

    place_mm: tuple[float, float, float]
    """x, y, z."""
    sigma_mm: tuple[float, float, float]
    """One standard deviation of each."""
    off_middle_mm: float
    """x over the belt's middle: how eccentrically the belt is loaded."""
    off_middle_sigma_mm: float
    """One standard deviation of it."""


@dataclass(frozen=True, slots=True)
class Fullness:
    """How full the belt is."""

    area_mm2: float
    """Mean cross-section of the load in the box."""
    capacity_mm2: float
    """Cross-section of the fully loaded belt; see `full_area_mm2`."""
    level: float
    """The one over the other."""
    whole_belt: bool
    """Whether both ends of the belt were seen; else the capacity is that of the part seen."""


@dataclass(frozen=True, slots=True)
class Summit:
    """The highest place of the load in the box."""

    height_mm: float
    """Above the empty belt, as the mean over a cell of the height map, and measured."""
    sigma_mm: float
    """One standard deviation of it."""
    place_mm: tuple[float, float]
    """x, y."""


@dataclass(frozen=True, slots=True, eq=False)
class Volume:
    """What lies on the belt within a box of the belt frame."""

    volume_mm3: float
    """Integral over the box of loaded minus empty height, vertical in the belt frame; overhang counts as solid."""
    sigma_mm3: float
    """One standard deviation of it."""
    causes: VolumeSigma
    """What it is put together from."""
    coverage: float
    """Share of the box in which the load's surface was measured, 0..1; the rest is interpolated."""
    across_mm: tuple[float, float]
    """The box in x."""
    along_mm: tuple[float, float]
    """The box in y."""
    load: HeightMap
    """Load over the empty belt, holes filled."""
    interpolated: NDArray[np.bool_]
    """(Ny, Nx) cells of ``load`` that were mostly not measured."""
    belt: Belt
    """The empty belt."""
    profiles: list[BeltProfile]
    """Cross-sections, each the mean over its stretch of belt; area times length adds up to the volume."""
    y_mm: NDArray[np.float64]
    """(N,) places along the belt, a pixel apart."""
    area_mm2: NDArray[np.float64]
    """(N,) cross-section of the load there, within the box's sides in x."""
    centre: Centre | None
    """Where the load's weight acts; None where there is hardly any load."""
    fullness: Fullness
    """Against what the belt can carry."""
    summit: Summit | None
    """None where nothing was measured in the box."""


def measure_volume(
    loaded: DepthMap,
    belt: Belt,
    camera: Camera,
    settings: VolumeSettings,
    *,
    across_mm: tuple[float, float] | None,
    along_mm: tuple[float, float] | None,
) -> Volume:
    """Volume of the load within a box of the belt frame.

    Without ``across_mm`` the box takes the belt's measured width, without ``along_mm`` the stretch in which the
    load is well measured. Heights below the empty belt count as negative: clipping them would add the noise.

    Raises
    ------
    InputError
        if the depth map is not the camera's size, or the box is empty or far larger than what was seen.
    MeasureError
        if nothing was measured in the box.
    """
    require_depth_of(camera, loaded, "loaded belt")
    # the empty belt's pixel, not the loaded frame's: so the grid is the same in every frame
    pixel_mm = float(belt.belt_from_core.inverse().translation_mm[2]) / float(camera.focal_px.mean())
    gather = 3 if settings.cell_mm is None else max(1, round(settings.cell_mm / pixel_mm))
    view = Box(belt.across_mm, belt.along_mm)
    whole = view if across_mm is None and along_mm is None else view.joined(across_mm, along_mm)
    load = load_over_belt(loaded, camera, belt, Grid.over(whole.across_mm, whole.along_mm, pixel_mm))
    box = chosen_box(load.measured, load.grid, across_mm, along_mm)
    narrow = load.measured & ~np.isfinite(load.height_mm)
    filled = fill_holes(load.height_mm, load.sigma_mm, narrow, pixel_mm, load.lean, windowed=load.windowed)
    weights = box.weights_mm(load.grid)
    area = filled.value_mm @ weights.across
    total = float(weights.along @ area)
    # an error that all pixels of the loaded frame share counts like the belt's slow ones
    doubted = replace(belt, drift_mm=float(np.hypot(belt.drift_mm, loaded.systematic_mm)))
    causes = volume_sigma(load, filled, weights, doubted)
    if across_mm is None:
        causes = replace(causes, unseen_mm3=_unseen_mm3(total, box, belt, camera))
    heights, interpolated = gathered(load, filled, gather), blocks_mean(~load.measured, gather) > 0.5
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
        profiles=profiles(filled.value_mm, load.measured, load.grid, box, settings.profile_every_mm),
        y_mm=load.grid.y_mm,
        area_mm2=area,
        centre=_centre(load, filled, weights, belt, total)
        if total > _LEAST_SURE * causes.total_mm3
        else None,
        fullness=_fullness(belt, total / (box.along_mm[1] - box.along_mm[0]), settings),
        summit=_summit(heights, interpolated, box),
    )


def _unseen_mm3(total_mm3: float, box: Box, belt: Belt, camera: Camera) -> float:
    """Return what a belt loaded alike carries beside a box that holds much less than its width; else 0."""
    distance = float(belt.belt_from_core.inverse().translation_mm[2])
    view = distance * camera.size_px[0] / float(camera.focal_px[0])
    width = max(belt.across_mm[1] - belt.across_mm[0], _LEAST_OF_VIEW * view)
    own = box.across_mm[1] - box.across_mm[0]
    return abs(total_mm3) * (width / own - 1) if own < _LEAST_OF_WIDTH * width else 0.0


def _centre(load: Load, filled: Filled, weights: Weights, belt: Belt, total_mm3: float) -> Centre:
    """Moments of the load over its volume; their σ as that of a volume in which each height counts by its lever."""
    grid = load.grid
    weight = np.outer(weights.along, weights.across)
    bottom = belt.surface_mm(grid.x_mm, grid.y_mm)
    x = np.broadcast_to(grid.x_mm[None], grid.shape)
    y = np.broadcast_to(grid.y_mm[:, None], grid.shape)
    place = [centre_mm(weight, filled.value_mm, part) for part in (x, y, bottom + filled.value_mm / 2)]
    # a column's top moves the mean height by its own height over the centre
    levers = (x - place[0], y - place[1], bottom + filled.value_mm - place[2])
    sigma = [volume_sigma(load, filled, weights, belt, lever).total_mm3 / total_mm3 for lever in levers]
    middle, middle_sigma = belt_middle_mm(belt)
    return Centre(
        (place[0], place[1], place[2]),
        (sigma[0], sigma[1], sigma[2]),
        place[0] - middle,
        float(np.hypot(sigma[0], middle_sigma)),
    )


def _fullness(belt: Belt, area_mm2: float, settings: VolumeSettings) -> Fullness:
    capacity = full_area_mm2(belt, float(np.deg2rad(settings.surcharge_deg)))
    edges = belt.edges
    whole = edges is not None and bool(np.isfinite(edges.left_mm) and np.isfinite(edges.right_mm))
    return Fullness(area_mm2, capacity, area_mm2 / capacity if capacity > 0 else np.nan, whole)


def _summit(load: HeightMap, interpolated: NDArray[np.bool_], box: Box) -> Summit | None:
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
