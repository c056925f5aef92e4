"""The measuring volume: the points before the core camera whose depth the rig is to measure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.solver.bundle_data import Geometry
from beltscape.core.geometry.rig import Rig

Array = NDArray[np.float64]

COLUMNS = 25
"""Points across the core's image; the predicted σ is smooth between them."""
NEAR, FAR = 0.05, 0.95
"""Quantiles of the boards' depths between which a rig without a known belt is taken to measure."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuringVolume:
    """Points that the rig is to measure."""

    name: str
    """As in "the part of the image that sees <name>"."""
    points_mm: Array
    """(N, 3) in the core frame."""
    is_given: bool
    """True if the belt is known; False if the whole view of the core stands for it."""


def make_view_volume(rig: Rig, geometry: Geometry) -> MeasuringVolume:
    """Return the core camera's view on the grid of depth maps, over the boards' depths; for an unknown belt."""
    camera = rig.core_camera
    width, height = camera.size_px
    rows = max(3, round(COLUMNS * height / width))
    u, v = np.linspace(0, width - 1, COLUMNS), np.linspace(0, height - 1, rows)
    grid = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    rays = (grid - camera.center_px) / camera.focal_px  # of the undistorted grid, on which depth is measured
    rays = rays[np.isfinite(camera.distort(rays)[:, 0])]
    depths = (geometry.board_rotation @ geometry.points_mm.T)[:, 2] + geometry.board_translation_mm[:, 2:]
    rays = np.column_stack([rays, np.ones(len(rays))])
    points = np.concatenate([depth * rays for depth in np.quantile(depths, [NEAR, FAR])])
    return MeasuringVolume(f"the whole view of {rig.core}", points, is_given=False)
