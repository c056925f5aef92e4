"""Cameras that are not where they were calibrated: knocked, vibrating, or moved with the whole rig."""

from __future__ import annotations

from typing import Annotated
from zlib import crc32

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.simulate.faults.base import Degrees, Fault, Millimetres, Seed
from beltscape.simulate.world import Station

Image = NDArray[np.uint8 | np.uint16]


class MovedCamera(Fault):
    """A camera was displaced after the calibration of the rig."""

    camera: str
    rotation_deg: tuple[Degrees, Degrees, Degrees] = (0.0, 0.0, 0.0)
    """Rotation vector in the camera's frame."""
    shift_mm: tuple[Millimetres, Millimetres, Millimetres] = (0.0, 0.0, 0.0)
    """Shift of its centre, in the camera's frame."""

    @property
    def displacement(self) -> Pose:
        """Return the pose that takes points from the camera's old frame to its new one."""
        rotation = Pose.of(np.deg2rad(self.rotation_deg), (0.0, 0.0, 0.0))
        return rotation @ Pose.of(np.eye(3), -np.array(self.shift_mm))

    def apply(self, station: Station, frame: int = 0) -> Station:
        """Return the station after the displacement; the calibrated rig remains that of the original station."""
        return displace_camera(station, self.camera, self.displacement) if self.is_active(frame) else station


class Vibration(Fault):
    """A camera that turns a little in every frame."""

    camera: str
    sigma_deg: Annotated[float, Field(ge=0, le=10)] = 0.05
    """Standard deviation of its rotation about each axis."""
    seed: Seed = 1

    def displacement_at(self, frame: int) -> Pose:
        """Return the pose that takes points from the calibrated camera's frame to that of a frame's."""
        rng = np.random.default_rng([self.seed, crc32(self.camera.encode()), frame])
        return Pose.of(np.deg2rad(self.sigma_deg) * rng.normal(size=3), (0.0, 0.0, 0.0))

    def apply(self, station: Station, frame: int = 0) -> Station:
        """Return the station in a frame."""
        if not self.is_active(frame):
            return station
        return displace_camera(station, self.camera, self.displacement_at(frame))


class MovedRig(Fault):
    """The whole rig was moved over the belt; belt, load and projector remain."""

    rotation_deg: tuple[Degrees, Degrees, Degrees] = (0.0, 0.0, 0.0)
    """Rotation vector in the core's frame."""
    shift_mm: tuple[Millimetres, Millimetres, Millimetres] = (0.0, 0.0, 0.0)
    """Shift of the core's centre, in its frame: z is down to the belt."""

    def apply(self, station: Station, frame: int = 0) -> Station:
        """Return the station after the displacement."""
        if not self.is_active(frame):
            return station
        rotation = Pose.of(np.deg2rad(self.rotation_deg), (0.0, 0.0, 0.0))
        displacement = rotation @ Pose.of(np.eye(3), -np.array(self.shift_mm))
        return Station(station.rig, displacement @ station.core_from_world)


def displace_camera(station: Station, camera: str, displacement: Pose) -> Station:
    """Return the station with one camera at another pose: ``displacement`` is new_from_old of its frame."""
    rig = station.rig
    from_world = {name: station.cam_from_world(name) for name in rig.cameras}
    from_world[camera] = displacement @ from_world[camera]
    core_from_world = from_world[rig.core]
    world_from_core = core_from_world.inverse()
    cam_from_core = {name: pose @ world_from_core for name, pose in from_world.items()}
    cam_from_core[rig.core] = Pose.identity()
    return Station(Rig(rig.core, rig.cameras, cam_from_core), core_from_world)


def displace_image(image: Image, camera: Camera, displacement: Pose, distance_mm: float) -> Image:
    """Return an image as the displaced camera sees it, by cubic interpolation.

    It is exact for a rotation. A shift is exact for the plane at ``distance_mm`` across the camera's axis.
    """
    width, height = camera.size_px
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    ideal = camera.undistort(np.stack([columns, rows], axis=-1))
    rays = np.concatenate([ideal, np.ones((height, width, 1))], axis=-1)
    old_from_new = displacement.inverse()
    turned, origin = rays @ old_from_new.rotation.T, old_from_new.translation_mm
    points = origin + turned * ((distance_mm - origin[2]) / turned[..., 2:])
    pixels = camera.project(points).astype(np.float32)
    moved = cv2.remap(image, pixels[..., 0], pixels[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(moved, image.dtype)
