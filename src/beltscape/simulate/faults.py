"""What goes wrong in a plant, each fault applied where it arises: to world, station, light, sensor or capture."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.pose import Pose
from beltscape.core.rig import Rig
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
        """The world without it."""
        return replace(world, projector=None)


class MovedCamera(_Fault):
    """A camera was knocked after the rig had been calibrated."""

    camera: str
    rotation_deg: tuple[Degrees, Degrees, Degrees] = (0.0, 0.0, 0.0)
    """Rotation vector in its own frame."""
    shift_mm: tuple[Millimetres, Millimetres, Millimetres] = (0.0, 0.0, 0.0)
    """Of its centre, in its own frame."""

    def apply(self, station: Station) -> Station:
        """The station as it now stands; the rig that was calibrated is the old one's."""
        rig = station.rig
        turn = Pose.of(np.deg2rad(self.rotation_deg), (0.0, 0.0, 0.0))
        knocked = turn @ Pose.of(np.eye(3), -np.array(self.shift_mm))
        from_world = {name: station.cam_from_world(name) for name in rig.cameras}
        from_world[self.camera] = knocked @ from_world[self.camera]
        core_from_world = from_world[rig.core]
        world_from_core = core_from_world.inverse()
        cam_from_core = {name: pose @ world_from_core for name, pose in from_world.items()}
        cam_from_core[rig.core] = Pose.identity()
        return Station(Rig(rig.core, rig.cameras, cam_from_core), core_from_world)


class Dirt(_Fault):
    """Specks on a lens or its window, far out of focus: soft dark blobs that stay where they are."""

    camera: str
    specks_px: tuple[tuple[Pixels, Pixels, Annotated[float, Field(gt=0, le=1e4)]], ...]
    """Column, row and radius of each."""
    opacity: Annotated[float, Field(ge=0, le=1)] = 0.6
    """Share of the light that a speck's middle holds back."""

    def apply(self, irradiance: NDArray[np.float32]) -> NDArray[np.float32]:
        """Light (H, W, 3) behind the dirt."""
        rows, columns = np.ogrid[: irradiance.shape[0], : irradiance.shape[1]]
        left = np.ones(irradiance.shape[:2])
        for column, row, radius in self.specks_px:
            distance = ((columns - column) ** 2 + (rows - row) ** 2) / radius**2
            left *= 1 - self.opacity * np.exp(-(distance**2))  # flat in the middle, soft at the rim
        return irradiance * left[..., None].astype(np.float32)


class OverExposure(_Fault):
    """A camera's exposure time is wrong by a factor."""

    camera: str
    factor: Annotated[float, Field(gt=0, le=1000)] = 4.0

    def apply(self, sensor: Sensor) -> Sensor:
        """The sensor as it is driven."""
        return sensor.model_copy(update={"electrons_at_1": sensor.electrons_at_1 * self.factor})


class MissingFrames(_Fault):
    """A camera does not deliver some frames: every so many-th, from one on."""

    camera: str
    every: Annotated[int, Field(ge=1)] = 1
    """1: all of them."""
    first: Annotated[int, Field(ge=0)] = 0

    def delivers(self, camera: str, frame: int) -> bool:
        """Whether this camera delivers the frame of this number."""
        lost = camera == self.camera and frame >= self.first and (frame - self.first) % self.every == 0
        return not lost
