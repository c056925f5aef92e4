"""Modules on a floor in a perfect depth camera: depth by exact rays, brightness by the faces' normals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.simulate.ray_casting import RayScene
from beltscape.simulate.shapes import make_box
from beltscape.simulate.solids.board import make_module_solids
from beltscape.simulate.world import Label, Solid
from beltscape.target.module import Module

CENTER_MM = 730.0
"""Depth of the base's upper face under the camera."""


def module(**changes: object) -> Module:
    """Return a module with the paper's sizes in another arrangement."""
    parts: dict[str, object] = {
        "base": {"size_mm": (285, 200, 10)},
        "cube": [
            {"name": "cube100", "edge_mm": 100, "center_mm": (-80, -42)},
            {"name": "cube60", "edge_mm": 60, "center_mm": (20, 52)},
            {"name": "cube40", "edge_mm": 40, "center_mm": (110, 66)},
        ],
        "sphere": [{"name": "sphere70", "diameter_mm": 70, "center_mm": (90, -45)}],
        "cylinder": [{"name": "rod", "diameter_mm": 24, "height_mm": 70, "center_mm": (-90, 65)}],
    }
    return Module.model_validate(parts | changes)


def rig() -> Rig:
    """Return a rig of one camera."""
    camera = Camera("cam0", (612, 512), np.array([580.0, 580.0]), np.array([305.5, 255.5]), np.zeros(5))
    return Rig("cam0", {"cam0": camera}, {"cam0": Pose.identity()})


def module_pose(x_mm: float = 0.0, y_mm: float = 0.0, turn_deg: float = 0.0, tilt_deg: float = 0.0) -> Pose:
    """Return core_from_module of a module below the camera, rotated about its z, then tilted about the core's x."""
    turn = Pose.of([0.0, 0.0, np.deg2rad(turn_deg)], np.zeros(3))
    down = Pose.of([np.pi + np.deg2rad(tilt_deg), 0.0, 0.0], np.array([x_mm, y_mm, CENTER_MM]))
    return down @ turn


class DepthCameraView:
    """The view of a camera of a module on a floor."""

    def __init__(self, module: Module, core_from_module: Pose) -> None:
        floor = make_box([900.0, 900.0, 20.0]).transform(
            core_from_module @ Pose(np.eye(3), np.array([0.0, 0.0, -20.0 - module.base.size_mm[2]]))
        )
        ground = Solid("floor", int(Label.FLOOR), floor.vertices_mm, floor.faces, (0.2, 0.2, 0.2))
        solids = (*make_module_solids(module, core_from_module), ground)
        self._scene = RayScene(solids)
        self._base_mm = np.concatenate([solid.vertices_mm for solid in solids[:-1]])

    def depth(self, sigma_mm: float = 1e-3) -> DepthMap:
        """Return the exact depth with the given σ."""
        camera = rig().core_camera
        rays = np.concatenate([camera.rays(), np.ones((512, 612, 1))], axis=-1)
        z = self._scene.cast(np.zeros(3), rays.reshape(-1, 3)).distance.reshape(512, 612)
        z = np.where(np.isfinite(z), z, np.nan).astype(np.float32)
        ones = np.ones(z.shape, np.float32)
        return DepthMap(z, sigma_mm * ones, 4 * ones.astype(np.uint8), ones)  # pyrefly: ignore[bad-argument-type]

    def render_brightness(self, fine: int = 3) -> NDArray[np.float32]:
        """Return (H, W) diffuse light, from above and one side; a pixel is the mean of fine² rays."""
        camera = rig().core_camera
        whole = np.zeros(camera.size_px[::-1], np.float32)
        corners = self._base_mm[:, :2] / self._base_mm[:, 2:] * camera.focal_px + camera.center_px
        low = np.maximum(corners.min(axis=0) - 40, 0).astype(int)
        high = np.minimum(corners.max(axis=0) + 40, camera.size_px).astype(int)
        width, height = high - low
        v, u = np.mgrid[: height * fine, : width * fine] / fine - 0.5 + 0.5 / fine
        x, y = (np.stack([u, v]) + (low - camera.center_px)[:, None, None]) / camera.focal_px[:, None, None]
        hits = self._scene.cast(np.zeros(3), np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3))
        normal = self._scene.face_normals(hits.face)
        light = 60 - 100 * normal[:, 2] + 25 * normal[:, 0] + 15 * normal[:, 1]
        label = self._scene.label_of_face[hits.face]
        shade = np.where(label == Label.FLOOR, 0.2, np.where(label == Label.BASE, 0.6, 1.0))
        light = np.where(hits.face < 0, 0, shade * light)
        light = light.reshape(height, fine, width, fine).mean(axis=(1, 3))
        whole[low[1] : high[1], low[0] : high[0]] = light
        return whole
