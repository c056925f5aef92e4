"""A small simulated rig over a small belt, and objects to place under it."""

from __future__ import annotations

import numpy as np

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.simulate.shapes import Mesh
from beltscape.simulate.solids.belt import BeltSettings, make_belt_solids
from beltscape.simulate.world import Label, Projector, Solid, Station, World

SIZE_PX = (160, 130)
BELT = BeltSettings(length_mm=1200)


def lens(name: str) -> Camera:
    return Camera(
        name,
        SIZE_PX,
        np.array([150.0, 151.0]),
        np.array([80.3, 63.9]),
        np.array([-0.07, 0.09, 4e-4, -1e-4, 0]),
    )


def above(x: float, y: float, z: float, turn=(0.0, 0.0, 0.0)) -> Pose:
    """cam_from_world of a camera at a place that looks straight down, then turned, radians."""
    down = np.diag([1.0, -1, -1])
    return Pose.of(turn, np.zeros(3)) @ Pose(down, -down @ np.array([x, y, z]))


def station() -> Station:
    core = above(2.0, -3.0, 740.0, (0.02, -0.03, 0.01))
    poses = {"cam0": core, "cam1": above(240, 0, 742, (0, 0.3, 0)), "cam2": above(-240, 0, 742, (0, -0.3, 0))}
    cam_from_core = {name: pose @ core.inverse() for name, pose in poses.items()}
    cam_from_core["cam0"] = Pose.identity()
    return Station(Rig("cam0", {name: lens(name) for name in poses}, cam_from_core), core)


def projector() -> Projector:
    camera = Camera("projector", (96, 60), np.full(2, 75.0), np.array([47.5, 29.5]), np.zeros(5))
    return Projector(camera, above(-60, 0, 760), np.ones((60, 96, 3), np.float32), 2.0)


def load(mesh: Mesh, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Solid:
    vertices = mesh.vertices_mm + np.array([x, y, z])
    return Solid("load", Label.MATERIAL, vertices, mesh.faces, (0.4, 0.4, 0.4))


def world(*solids: Solid, belt: BeltSettings = BELT, lit: bool = True) -> World:
    return World((*make_belt_solids(belt), *solids), projector() if lit else None)
