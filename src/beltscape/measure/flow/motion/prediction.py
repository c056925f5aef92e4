"""How a belt should move on, from what its motion was."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Foresight:
    """What a frame tells of the motion to the next ones."""

    along: NDArray[np.float64]
    """(3,) the travel's direction in the core's frame."""
    ratio: float
    """Encoder over material."""
    speed: float | None
    """mm per unit of the meter's clock; None: not known."""

    def motion_mm(self, clock_step: float, encoder_step_mm: float | None) -> NDArray[np.float64] | None:
        """(3,) displacement of the material in the core's frame; ``encoder_step_mm`` None: by the speed.

        None where neither is known.
        """
        if encoder_step_mm is not None:
            return self.along * (encoder_step_mm / self.ratio)
        return None if self.speed is None else self.along * (self.speed * clock_step)
