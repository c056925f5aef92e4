"""What sensors that measure profile by profile have in common: a belt that carries the scene past them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ProfileScan:
    """Profiles one after the other, each at its own place of the belt as the encoder tells it."""

    points_mm: Array
    """(P, C, 3) in the scene's world, as it stood when the belt's position was 0; NaN: not measured."""
    sigma_mm: Array
    """(P, C) one standard deviation of the height, as predicted; NaN as the points."""
    step_mm: float
    """From profile to profile, along the belt."""


def positions_mm(along_mm: tuple[float, float], step_mm: float) -> Array:
    """(P,) places along the belt, from end to end."""
    first, last = along_mm
    return np.arange(first, last + step_mm / 2, step_mm)
