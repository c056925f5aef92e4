"""What was measured of a module."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.pose import Pose
from beltscape.measure.features.face import Face
from beltscape.measure.features.pose.nominal import NominalView
from beltscape.measure.features.sphere import Ball
from beltscape.target.module import Module


@dataclass(frozen=True, slots=True)
class Quantity:
    """One dimension."""

    name: str
    """Of the feature; ``base``; ``step:LARGE-SMALL``."""
    quantity: str
    """edge, height, radius, diameter, length, width, height_difference."""
    nominal_mm: float
    measured_mm: float
    """NaN where it could not be measured."""
    sigma_mm: float
    """One standard deviation; NaN where it could not be measured."""
    points: int
    """Pixels, or pieces of edge, that it rests on."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeLine:
    """One located edge, as it is drawn."""

    name: str
    """Of the feature."""
    line_mm: NDArray[np.float64]
    """(n, 3) polyline in the core's frame, on the face."""
    nominal_mm: NDArray[np.float64]
    """(n, 3) where the perfect module has it."""
    sigma_mm: float
    by_image: bool
    """Whether an image located it, or only the depth map's rim."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredModule:
    """A module in a frame."""

    module: Module
    core_from_module: Pose
    agreement: float
    """Share of its surface that was recognised, less what disagrees."""
    view: NominalView
    """The perfect module at that pose."""
    faces: Mapping[str, Face]
    """Upper faces that were measured, by feature; ``base`` among them."""
    balls: Mapping[str, Ball]
    """Spheres that were measured."""
    edges: tuple[EdgeLine, ...]
    quantities: tuple[Quantity, ...]
    warnings: tuple[str, ...]
