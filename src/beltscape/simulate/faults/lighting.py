"""Faults of light and exposure: the projector's, the sun's, the mains flicker of lamps, a wrong exposure time."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from beltscape.core.geometry.pose import Pose
from beltscape.simulate.faults.base import Degrees, Fault, GrowingFault, Millimetres, Share
from beltscape.simulate.faults.obstruction import BlurPx, blur
from beltscape.simulate.rendering.sensor import Sensor
from beltscape.simulate.world import World

Light = NDArray[np.float32]

_DOT = 0.03
"""Opening width that removes the projected dots from an image, as a share of its width: over a dot and its gap."""


class ProjectorFault(GrowingFault):
    """The projector is off or dim, out of focus, or moved; a growing one is an ageing lamp."""

    power: Annotated[float, Field(ge=0, le=10)] = 1.0
    """Share of its light that is left; 0: off."""
    blur_px: BlurPx = 0.0
    """σ of the blur that is added, in the projector's pixels."""
    rotation_deg: tuple[Degrees, Degrees, Degrees] = (0.0, 0.0, 0.0)
    """Rotation vector in the projector's frame."""
    shift_mm: tuple[Millimetres, Millimetres, Millimetres] = (0.0, 0.0, 0.0)
    """Shift in the projector's frame."""

    def apply(self, world: World, frame: int = 0) -> World:
        """Return the world with the projector as it is in a frame."""
        extent, projector = self.extent_at(frame), world.projector
        if extent == 0 or projector is None:
            return world
        power = self.power_at(frame)
        if power == 0:
            return replace(world, projector=None)
        turn = Pose.of(extent * np.deg2rad(self.rotation_deg), (0.0, 0.0, 0.0))
        displacement = turn @ Pose.of(np.eye(3), -extent * np.array(self.shift_mm))
        pattern = np.asarray(blur(projector.pattern, self.blur_px * extent), np.float32)
        pose = displacement @ projector.projector_from_world
        changed = replace(
            projector, projector_from_world=pose, pattern=pattern, power=projector.power * power
        )
        return replace(world, projector=changed)

    def power_at(self, frame: float) -> float:
        """Return the share of the projector's light that is left in a frame."""
        return 1 - self.extent_at(frame) * (1 - self.power)

    def apply_to_image(self, light: Light, frame: int = 0) -> Light:
        """Return an image whose projected pattern is dimmed and blurred; the ambient light is estimated.

        The ambient light is taken as the image's opening over the distance of dots: what lies under them. A moved
        projector cannot be made from an image.
        """
        extent = self.extent_at(frame)
        if extent == 0:
            return light
        width = max(3, round(_DOT * light.shape[1]) | 1)
        square = np.ones((width, width), np.uint8)
        opened: Any = cv2.dilate(cv2.erode(light, square), square)
        ambient = np.minimum(blur(opened.reshape(light.shape), width / 2), light)
        pattern = blur(light - ambient, self.blur_px * extent)
        return np.asarray(ambient + self.power_at(frame) * pattern, np.float32)


class Sunlight(Fault):
    """A patch of sunlight, at the same place in every image of a camera."""

    camera: str = ""
    """Empty: every camera."""
    center: tuple[Share, Share] = (0.6, 0.4)
    """Its place, column and row, as shares of the image."""
    radius: Annotated[float, Field(gt=0, le=2)] = 0.15
    """As a share of the image's width."""
    strength: Annotated[float, Field(ge=0, le=1000)] = 2.0
    """Light in its middle, as a multiple of the image's brightest percent."""

    def apply(self, light: Light, frame: int = 0) -> Light:
        """Return the light with the patch."""
        if not self.is_active(frame):
            return light
        height, width = light.shape[:2]
        rows, columns = np.ogrid[:height, :width]
        distance = np.hypot(columns - self.center[0] * width, rows - self.center[1] * height)
        patch = np.clip((self.radius * width - distance) / (0.1 * self.radius * width), 0, 1)
        bright = float(np.quantile(light, 0.99))
        patch = patch if light.ndim == 2 else patch[..., None]
        return np.asarray(light + self.strength * bright * patch, np.float32)


class Flicker(Fault):
    """Lamps that flicker with the mains: the light of every frame by its instant."""

    camera: str = ""
    """Empty: every camera."""
    frequency_hz: Annotated[float, Field(gt=0, le=1e5)] = 100.3
    """Of the light: twice the mains'; it beats with the frame rate."""
    amplitude: Share = 0.3

    def apply(self, light: Light, frame: int, time_s: float) -> Light:
        """Return the light at an instant."""
        if not self.is_active(frame):
            return light
        factor = 1 + self.amplitude * np.sin(2 * np.pi * self.frequency_hz * time_s)
        return light * np.float32(factor)


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
