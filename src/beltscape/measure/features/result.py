"""The results of measuring a module."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.pose import Pose
from beltscape.measure.features.face import Face
from beltscape.measure.features.solids import NominalView
from beltscape.measure.features.sphere import FittedSphere
from beltscape.target.module import Module


@dataclass(frozen=True, slots=True)
class MeasuredDimension:
    """One measured dimension."""

    name: str
    """Name of the feature, or ``base``, or ``step:LARGE-SMALL``."""
    quantity: str
    """edge, height, radius, diameter, length, width, height_difference."""
    nominal_mm: float
    measured_mm: float
    """NaN where the dimension could not be measured."""
    sigma_mm: float
    """One standard deviation; NaN where the dimension could not be measured."""
    points: int
    """Number of pixels, or pieces of edge, that were used."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeLine:
    """One located edge as a polyline."""

    name: str
    """Name of the feature."""
    line_mm: NDArray[np.float64]
    """(n, 3) polyline in the core's frame, on the face."""
    nominal_mm: NDArray[np.float64]
    """(n, 3) the edge of the nominal module."""
    sigma_mm: float
    by_image: bool
    """Whether an image located the edge, or only the depth map's rim."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredModule:
    """A module measured in one frame."""

    module: Module
    core_from_module: Pose
    agreement: float
    """Share of the module's surface with the right height, less a penalty for wrong heights."""
    view: NominalView
    """The nominal module rendered at that pose."""
    faces: Mapping[str, Face]
    """Measured upper faces by feature, including ``base``."""
    spheres: Mapping[str, FittedSphere]
    """Measured spheres by feature."""
    edges: tuple[EdgeLine, ...]
    quantities: tuple[MeasuredDimension, ...]
    warnings: tuple[str, ...]
