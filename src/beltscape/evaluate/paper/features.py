"""The module's dimensions by each method, from depth alone or with the core camera's images."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import MeasureError
from beltscape.core.frames import to_grey
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.rig import Rig
from beltscape.evaluate.paper.dimensions import MeasuredDimensions
from beltscape.evaluate.paper.laboratory import Laboratory
from beltscape.evaluate.paper.surfaces import FRAME, ScoredDepth
from beltscape.files.capture import read_capture
from beltscape.files.rasters.images import read_image
from beltscape.measure.features.measure import measure_module
from beltscape.stereo.pointcloud.cloud import undistort_image
from beltscape.target.module import Module

PLAIN = "multiview, plain image"
"""Beltscape with an additional image without speckle."""

Grey = NDArray[np.float32]


def measure_features(
    found: ScoredDepth, rig: Rig, module: Module, *, pattern: Grey | None = None, plain: Grey | None = None
) -> MeasuredDimensions:
    """Return the dimensions that `measure features` measures in a depth map; empty if it shows no module.

    ``pattern`` and ``plain`` (H, W) are the core camera's images with and without speckle, on the depth map's grid.
    """
    if found.folder is None:
        return {}
    try:
        measured = measure_module(found.depth, rig, module, pattern=pattern, plain=plain)
    except MeasureError:
        return {}
    names = map_paper_names(module)
    return {
        f"{names.get(one.name, one.name)} {one.quantity}": (one.measured_mm, one.sigma_mm)
        for one in measured.quantities
        if np.isfinite(one.measured_mm)
    }


def map_paper_names(module: Module) -> Mapping[str, str]:
    """Map a module's names to those of data/paper.toml, which have kind and size: "cylinder20" for 20 mm."""
    names = {cube.name: f"cube{cube.edge_mm:g}" for cube in module.cube}
    names |= {one.name: f"sphere{one.diameter_mm:g}" for one in module.sphere}
    names |= {one.name: f"cylinder{one.diameter_mm:g}" for one in module.cylinder}
    steps = pairwise(sorted(module.cube, key=lambda cube: -cube.edge_mm))
    return names | {f"step:{a.name}-{b.name}": f"step:{names[a.name]}-{names[b.name]}" for a, b in steps}


def read_core_image(lab: Laboratory, scene: str, camera: Camera) -> Grey | None:
    """Return the core camera's image of a scene on its pinhole grid, (H, W); None without such a capture."""
    if scene not in lab.scenes:
        return None
    return to_grey(undistort_image(read_image(_image(lab.scenes[scene].capture, camera.name)), camera))


def _image(capture: Path, camera: str) -> Path:
    return read_capture(capture).files[camera][FRAME]
