"""Profile scans: the result of sensors that measure profile by profile while the belt carries the scene past them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ProfileScan:
    """Profiles one after another, each at its own position of the belt by the encoder."""

    points_mm: Array
    """(P, C, 3) in the scene's world at belt position 0; NaN: not measured."""
    sigma_mm: Array
    """(P, C) predicted standard deviation of the height; NaN as the points."""
    step_mm: float
    """Distance of consecutive profiles along the belt."""


def positions_mm(along_mm: tuple[float, float], step_mm: float) -> Array:
    """Return (P,) positions along the belt, from end to end."""
    first, last = along_mm
    return np.arange(first, last + step_mm / 2, step_mm)
