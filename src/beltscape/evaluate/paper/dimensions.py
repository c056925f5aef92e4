"""Tables 2 and 3: the module's dimensions by the paper, its method, Beltscape and the baselines.

The paper's published numbers are read from data/paper.toml; a method measures from depth alone or with the core
camera's images.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from beltscape.core.errors import MeasureError
from beltscape.core.frames import to_grey
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.rig import Rig
from beltscape.evaluate.paper.laboratory import Laboratory
from beltscape.evaluate.paper.surfaces import FRAME, ScoredDepth
from beltscape.files.capture import read_capture
from beltscape.files.images import read_image
from beltscape.files.toml_text import read_toml, validate
from beltscape.measure.features.measure import measure_module
from beltscape.stereo.pointcloud import undistort_image
from beltscape.target.module import Module


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Dimension(_Part):
    """A row of the paper's Tables 2 and 3."""

    row: int
    name: str
    """Name in the tables."""
    of: tuple[str, ...]
    """"name quantity" as in `measure features`; the mean of several."""
    actual_mm: float
    table2_mm: float
    """Dimension by the paper's method."""
    table3_mm: float | None = None
    """Dimension by the paper's time-of-flight camera; None: the table has none."""


class PointDensity(_Part):
    """Ratio of measured points on the material with and without speckle."""

    place: str
    ratio: float


class PaperNumbers(_Part):
    """All published numbers."""

    source: str
    doi: str
    density: PointDensity
    dimension: tuple[Dimension, ...]


def read_paper_numbers() -> PaperNumbers:
    """Read the numbers that ship with Beltscape."""
    path = Path(str(files("beltscape") / "data" / "paper.toml"))
    return validate(path, PaperNumbers, read_toml(path))


MeasuredDimensions = Mapping[str, tuple[float, float]]
""""name quantity" → measured value and its σ, mm; without those that were not measured."""


@dataclass(frozen=True, slots=True, eq=False)
class DimensionRow:
    """One dimension as measured by each method."""

    dimension: Dimension
    measured_mm: Mapping[str, float]
    """Measured dimension by method; NaN: not measured."""
    sigma_mm: Mapping[str, float]
    """Predicted σ by method; NaN: none."""

    def error_mm(self, by: str) -> float:
        """Return measured minus actual value."""
        return self.measured_mm[by] - self.dimension.actual_mm


def tabulate_dimensions(
    dimensions: Sequence[Dimension], measured: Mapping[str, MeasuredDimensions]
) -> tuple[DimensionRow, ...]:
    """Return every dimension by every method; a mean of several quantities requires all of them."""
    rows: list[DimensionRow] = []
    for dimension in dimensions:
        values = {by: _mean(dimension, quantities) for by, quantities in measured.items()}
        rows.append(
            DimensionRow(
                dimension,
                {by: value for by, (value, _) in values.items()},
                {by: sigma for by, (_, sigma) in values.items()},
            )
        )
    return tuple(rows)


def largest_error_mm(rows: Sequence[DimensionRow], by: str) -> float:
    """Return the largest error of the measured dimensions; NaN without any."""
    errors = np.abs([row.error_mm(by) for row in rows])
    return float(np.nanmax(errors)) if np.isfinite(errors).any() else np.nan


def _mean(dimension: Dimension, quantities: MeasuredDimensions) -> tuple[float, float]:
    if any(name not in quantities for name in dimension.of):
        return np.nan, np.nan
    values, sigmas = np.transpose([quantities[name] for name in dimension.of])
    # neighbouring steps share a cube, so their errors do not average out; the RMS σ of one step is used
    return float(values.mean()), float(np.sqrt((sigmas**2).mean()))


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
