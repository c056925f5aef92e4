"""Prediction of the belt's motion from its past motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class MotionPrediction:
    """The prediction of the motion after a frame."""

    along: NDArray[np.float64]
    """(3,) direction of travel in the core's frame."""
    ratio: float
    """Encoder's over the material's motion."""
    speed: float | None
    """mm per unit of the meter's clock; None if unknown."""
    uses_encoder: bool = True
    """Whether the encoder is trusted."""
