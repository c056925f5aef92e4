"""Ray-cast frames of a speckled trough with a box and a cylinder, with exact depth."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import FrameSet
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig

SIZE_PX = (400, 320)
BOX = (np.array([-90.0, -50.0, 0.0]), np.array([-10.0, 30.0, 60.0]))
CYLINDER = (70.0, 10.0, 10.0, 90.0)
"""x, y, radius, height, mm: a slender object that the depth range must contain."""


def make_camera(name: str, size_px: tuple[int, int] = SIZE_PX) -> Camera:
    focal = 0.95 * size_px[0]
    return Camera(
        name,
        size_px,
        np.array([focal, focal * 1.001]),
        np.array([size_px[0] / 2 + 1.5, size_px[1] / 2 - 2.2]),
        np.array([-0.07, 0.09, 3e-4, -2e-4, 0.0]),
    )


def look_at(center_mm: NDArray[np.float64], target_mm: NDArray[np.float64]) -> Pose:
    """Return cam_from_world of a camera that looks at a point; its u axis is closest to world x."""
    z = (target_mm - center_mm) / np.linalg.norm(target_mm - center_mm)
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z]).astype(np.float64)
    return Pose(rotation, -rotation @ center_mm)


def make_world_rig(
    height_mm: float = 740.0,
    baseline_mm: float = 240.0,
    *,
    parallel: bool = False,
    angles_deg=(0, 90, 180, 270),
) -> tuple[Rig, Pose]:
    """Return a rig with auxiliaries around the core at these angles, and core_from_world."""
    core = look_at(np.array([1.0, -2.0, height_mm]), np.array([4.0, 1.0, 0.0]))
    poses = {"cam0": Pose.identity()}
    for i, angle in enumerate(np.deg2rad(angles_deg), start=1):
        center = baseline_mm * np.array([np.cos(angle), np.sin(angle), 0.0]) + [
            1.0,
            -2.0,
            height_mm + 3.0 * i,
        ]
        target = center - [0, 0, height_mm] if parallel else np.array([2.0 * i, -3.0, 30.0])
        poses[f"cam{i}"] = look_at(center, target) @ core.inverse()
    return Rig("cam0", {name: make_camera(name) for name in poses}, poses), core


def cast_rays(
    cam: Camera, cam_from_world: Pose, pixels: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the world points (H, W, 3) that each distorted pixel sees, and their depth (H, W), mm.

    With ``pixels`` None rays go through the distorted pixels; otherwise they are undistorted rays (H, W, 2).
    """
    if pixels is None:
        u, v = np.meshgrid(np.arange(cam.size_px[0]), np.arange(cam.size_px[1]))
        pixels = cam.undistort(np.stack([u, v], axis=-1))
    rays = np.concatenate([pixels, np.ones_like(pixels[..., :1])], axis=-1)
    origin, rays = cam_from_world.center_mm, rays @ cam_from_world.rotation
    depth = np.minimum.reduce(
        [_hit_trough(origin, rays), _hit_box(origin, rays), _hit_cylinder(origin, rays)]
    )
    return origin + rays * depth[..., None], depth


def _hit_trough(origin, rays):
    rise = np.tan(np.deg2rad(20.0))
    flat = -origin[2] / rays[..., 2]
    hits = [flat]
    for side in (-1, 1):  # half-spaces z = rise·(side·x − 150); the surface is the first one entered
        gain = rays[..., 2] - rise * side * rays[..., 0]
        hits.append((rise * (side * origin[0] - 150.0) - origin[2]) / gain)
    return np.minimum.reduce([np.where(t > 0, t, np.inf) for t in hits])


def _hit_box(origin, rays):
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (BOX[0] - origin) / rays, (BOX[1] - origin) / rays
    enter, leave = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
    return np.where((enter <= leave) & (enter > 0), enter, np.inf)


def _hit_cylinder(origin, rays):
    x, y, radius, height = CYLINDER
    top = (height - origin[2]) / rays[..., 2]
    at = origin[:2] + rays[..., :2] * top[..., None] - [x, y]
    hit_top = np.where((at**2).sum(axis=-1) <= radius**2, top, np.inf)
    dx, dy = origin[0] - x, origin[1] - y
    a = rays[..., 0] ** 2 + rays[..., 1] ** 2
    b = rays[..., 0] * dx + rays[..., 1] * dy
    root = b**2 - a * (dx**2 + dy**2 - radius**2)
    t = (-b - np.sqrt(np.maximum(root, 0))) / np.maximum(a, 1e-12)
    z = origin[2] + t * rays[..., 2]
    return np.minimum(hit_top, np.where((root > 0) & (z > 0) & (z < height) & (t > 0), t, np.inf))


@cache
def make_speckle() -> np.ndarray:
    """Return (1200, 1200) float32 smooth random brightness, one texel per mm, about 3 mm per dot."""
    noise = np.random.default_rng(7).normal(size=(1200, 1200)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.6)
    return np.clip(40 + 45 * smooth / smooth.std(), 2, 220).astype(np.float32)


def render_frame(rig: Rig, core_from_world: Pose, *, noise_counts: float = 1.0) -> FrameSet:
    """Return 8-bit grey images of all cameras; the speckle is projected obliquely."""
    rng = np.random.default_rng(3)
    images = {}
    for name, cam in rig.cameras.items():
        points, _ = cast_rays(cam, rig.cam_from_core[name] @ core_from_world)
        # oblique, so that sides are lit too
        at = (points[..., :2] + 600 + 0.35 * points[..., 2:]).astype(np.float32)
        seen = cv2.remap(make_speckle(), at, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        images[name] = np.clip(np.rint(seen + rng.normal(0, noise_counts, seen.shape)), 0, 255).astype(
            np.uint8
        )
    return FrameSet("000", images)


def compute_true_depth(rig: Rig, core_from_world: Pose) -> np.ndarray:
    """Return the (H, W) depth on the core's pinhole grid, mm."""
    cam = rig.core_camera
    return cast_rays(cam, core_from_world, cam.rays())[1]
