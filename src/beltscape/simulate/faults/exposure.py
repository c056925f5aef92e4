"""Wrong exposure of a camera."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from beltscape.simulate.faults.base import Fault
from beltscape.simulate.rendering.sensor import Sensor


class OverExposure(Fault):
    """A camera's exposure time is wrong by a factor: too long, or below 1 too short."""

    camera: str
    factor: Annotated[float, Field(gt=0, le=1000)] = 4.0

    def apply(self, sensor: Sensor, frame: int = 0) -> Sensor:
        """Return the sensor with the wrong exposure."""
        if not self.is_active(frame):
            return sensor
        return sensor.model_copy(update={"electrons_at_1": sensor.electrons_at_1 * self.factor})

    def apply_to_image(self, light: NDArray[np.float32], frame: int = 0) -> NDArray[np.float32]:
        """Return an image with the wrong exposure; what was saturated before remains so only above a factor of 1."""
        return light * np.float32(self.factor) if self.is_active(frame) else light
