"""Volume between a loaded and an empty belt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.belt import BeltProfile, HeightMap
from beltscape.core.camera import Camera
from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.measure.belt import Belt, find_belt
from beltscape.measure.box import chosen_box, profiles, seen_box
from beltscape.measure.holes import fill_holes
from beltscape.measure.load import gathered, load_over_belt
from beltscape.measure.settings import VolumeSettings
from beltscape.measure.surface import Grid, blocks_mean, pixel_size_mm
from beltscape.measure.uncertainty import volume_sigma


@dataclass(frozen=True, slots=True, eq=False)
class Volume:
    """What lies on the belt within a box of the belt frame."""

    volume_mm3: float
    """Integral over the box of loaded minus empty height, vertical in the belt frame; overhang counts as solid."""
    sigma_mm3: float
    """One standard deviation of it."""
    coverage: float
    """Share of the box in which both surfaces were measured, 0..1; the rest is interpolated."""
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


def measure_volume(
    loaded: DepthMap,
    empty: DepthMap,
    camera: Camera,
    settings: VolumeSettings,
    *,
    across_mm: tuple[float, float] | None,
    along_mm: tuple[float, float] | None,
) -> Volume:
    """Volume of the load within a box of the belt frame.

    Without ``across_mm`` the box takes the belt's measured width, without ``along_mm`` the stretch in which both
    surfaces are well measured. Heights below the empty belt count as negative: clipping them would add the noise.

    Raises
    ------
    InputError
        if the depth maps are not the camera's size, or the box is empty or far larger than what was seen.
    MeasureError
        if there is no belt, or nothing was measured in the box.
    """
    _demand_same_size(loaded, empty)
    belt = find_belt(empty, camera)
    pixel_mm = pixel_size_mm(empty, camera)
    gather = 3 if settings.cell_mm is None else max(1, round(settings.cell_mm / pixel_mm))
    view = seen_box(empty, camera, belt)
    whole = view if across_mm is None and along_mm is None else view.joined(across_mm, along_mm)
    load = load_over_belt(loaded, empty, camera, belt, Grid.over(whole.across_mm, whole.along_mm, pixel_mm))
    box = chosen_box(load.measured, load.grid, across_mm, along_mm)
    filled = fill_holes(load.height_mm, load.sigma_mm, load.measured, pixel_mm)
    weights = box.weights_mm(load.grid)
    area = filled.value_mm @ weights.across
    return Volume(
        volume_mm3=float(weights.along @ area),
        sigma_mm3=volume_sigma(load, filled, weights, belt),
        coverage=weights.share(load.measured),
        across_mm=box.across_mm,
        along_mm=box.along_mm,
        load=gathered(load, filled, gather),
        interpolated=blocks_mean(~load.measured, gather) > 0.5,
        belt=belt,
        profiles=profiles(filled.value_mm, load.measured, load.grid, box, settings.profile_every_mm),
        y_mm=load.grid.y_mm,
        area_mm2=area,
    )


def _demand_same_size(loaded: DepthMap, empty: DepthMap) -> None:
    (rows, columns), (empty_rows, empty_columns) = loaded.depth_mm.shape, empty.depth_mm.shape
    if (rows, columns) != (empty_rows, empty_columns):
        raise InputError(
            f"loaded and empty belt: depth maps of {columns}×{rows} and {empty_columns}×{empty_rows} pixels; "
            "reconstruct both with the same rig"
        )
