"""Faults of a plant, each applied where it arises: to world, station, light, sensor or capture."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.simulate.geometry.world import Station, World
from beltscape.simulate.rendering.sensor import Sensor

Degrees = Annotated[float, Field(ge=-180, le=180)]
Millimetres = Annotated[float, Field(ge=-1e4, le=1e4)]
Pixels = Annotated[float, Field(ge=-1e5, le=1e5)]


class _Fault(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class DeadProjector(_Fault):
    """The projector's light is off."""

    def apply(self, world: World) -> World:
        """Return the world without the projector."""
        return replace(world, projector=None)


class MovedCamera(_Fault):
    """A camera was displaced after the calibration of the rig."""

    camera: str
    rotation_deg: tuple[Degrees, Degrees, Degrees] = (0.0, 0.0, 0.0)
    """Rotation vector in the camera's frame."""
    shift_mm: tuple[Millimetres, Millimetres, Millimetres] = (0.0, 0.0, 0.0)
    """Shift of its centre, in the camera's frame."""

    def apply(self, station: Station) -> Station:
        """Return the station after the displacement; the calibrated rig remains that of the original station."""
        rig = station.rig
        rotation = Pose.of(np.deg2rad(self.rotation_deg), (0.0, 0.0, 0.0))
        displacement = rotation @ Pose.of(np.eye(3), -np.array(self.shift_mm))
        from_world = {name: station.cam_from_world(name) for name in rig.cameras}
        from_world[self.camera] = displacement @ from_world[self.camera]
        core_from_world = from_world[rig.core]
        world_from_core = core_from_world.inverse()
        cam_from_core = {name: pose @ world_from_core for name, pose in from_world.items()}
        cam_from_core[rig.core] = Pose.identity()
        return Station(Rig(rig.core, rig.cameras, cam_from_core), core_from_world)


class Dirt(_Fault):
    """Specks on a lens or its window, far out of focus: soft dark spots at fixed pixels."""

    camera: str
    specks_px: tuple[tuple[Pixels, Pixels, Annotated[float, Field(gt=0, le=1e4)]], ...]
    """Column, row and radius of each."""
    opacity: Annotated[float, Field(ge=0, le=1)] = 0.6
    """Share of the light that the centre of a speck absorbs."""

    def apply(self, irradiance: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the light (H, W, 3) behind the dirt."""
        rows, columns = np.ogrid[: irradiance.shape[0], : irradiance.shape[1]]
        transmission = np.ones(irradiance.shape[:2])
        for column, row, radius in self.specks_px:
            distance = ((columns - column) ** 2 + (rows - row) ** 2) / radius**2
            transmission *= 1 - self.opacity * np.exp(-(distance**2))  # flat in the middle, soft at the rim
        return irradiance * transmission[..., None].astype(np.float32)


class OverExposure(_Fault):
    """A camera's exposure time is wrong by a factor."""

    camera: str
    factor: Annotated[float, Field(gt=0, le=1000)] = 4.0

    def apply(self, sensor: Sensor) -> Sensor:
        """Return the sensor with the wrong exposure."""
        return sensor.model_copy(update={"electrons_at_1": sensor.electrons_at_1 * self.factor})


class MissingFrames(_Fault):
    """A camera does not deliver every n-th frame."""

    camera: str
    every: Annotated[int, Field(ge=1)] = 1
    """Interval of the missing frames; 1: all of them."""
    first: Annotated[int, Field(ge=0)] = 0

    def delivers(self, camera: str, frame: int) -> bool:
        """Return whether this camera delivers the frame of this number."""
        is_missing = camera == self.camera and frame >= self.first and (frame - self.first) % self.every == 0
        return not is_missing
