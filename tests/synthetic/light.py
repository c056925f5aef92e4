"""Small worlds to render: a plane below one camera."""

from __future__ import annotations

import numpy as np

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.simulate.world import Label, Projector, Solid, Station

DOWN = Pose.of([np.pi, 0, 0], [0, 0, 700])
"""A camera or projector 700 mm above the belt that looks straight down."""


def camera(width=240, height=200, focal=300.0, distortion=(-0.08, 0.1, 4e-4, -3e-4, 0.0), name="cam0"):
    center = np.array([width * 0.51 - 0.5, height * 0.48 - 0.5])
    return Camera(
        name, (width, height), np.array([focal, focal * 1.004]), center, np.array(distortion, dtype=float)
    )


def station(*cameras, poses=(DOWN,)):
    """Return a station; the first camera is the core, poses are cam_from_world."""
    core = poses[0]
    return Station(
        Rig(
            cameras[0].name,
            {cam.name: cam for cam in cameras},
            {cam.name: pose @ core.inverse() for cam, pose in zip(cameras, poses, strict=True)},
        ),
        core,
    )


def plane(width_mm=500.0, height_mm=400.0, z_mm=0.0, at_mm=(0.0, 0.0), label=Label.BELT, colour=1.0, **more):
    """Return a horizontal rectangle; the top row of its texture is at +y."""
    x, y = (
        np.array([-1, 1, 1, -1]) * width_mm / 2 + at_mm[0],
        np.array([1, 1, -1, -1]) * height_mm / 2 + at_mm[1],
    )
    return Solid(
        "plane",
        label,
        np.column_stack([x, y, np.full(4, float(z_mm))]),
        np.array([[0, 2, 1], [0, 3, 2]]),
        (colour, colour, colour),
        uv=np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]),
        **more,
    )


def projector(pattern, focal=(400.0, 404.0), center=None, pose=DOWN, power=1.0):
    height, width = pattern.shape[:2]
    center = np.array([(width - 1) / 2, (height - 1) / 2]) if center is None else np.array(center)
    device = Camera("projector", (width, height), np.array(focal), center, np.zeros(5))
    colours = (
        np.repeat(np.asarray(pattern, np.float32)[..., None], 3, axis=-1) if pattern.ndim == 2 else pattern
    )
    return Projector(device, pose, colours, power)
