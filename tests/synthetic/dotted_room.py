"""A room under sparse projected dots: plane walls and cupboards over a wide depth range, with exact cameras.

All dots are alike, near-regular or random, so that single ones are easily mistaken for each other.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Literal

import cv2
import numpy as np

from beltscape.core.frames import FrameSet
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig

Arrangement = Literal["jittered", "random"]
Error = Literal[
    "focal_x", "focal_y", "center_x", "center_y", "scale", "roll", "pitch", "baseline_length", "baseline_side"
]
PROJECTOR_MM = np.array([60.0, -80.0, 0.0])
_TEXTURE_PX = 3200
"""Side of the projected texture; it covers a field of view of 2 · 45°."""


def make_room_rig(
    auxiliaries: int = 1, *, width_px: int = 1024, baseline_mm: float = 220.0, tilt_deg: float = 4.0
) -> Rig:
    """Return a rig of parallel or slightly convergent cameras: right, below, left and above the core."""
    size, focal = (width_px, round(0.52 * width_px)), 0.85 * width_px
    poses = {"left": Pose.identity()}
    for i, name in enumerate(("right", "below", "other", "above")[:auxiliaries]):
        angle = np.pi / 2 * i + 0.03
        centre = baseline_mm * np.array([np.cos(angle), np.sin(angle), 0.03])
        tilt = np.deg2rad(tilt_deg) * np.array([np.sin(angle), -np.cos(angle), 0.1])
        rotation = Pose.of(tilt, np.zeros(3)).rotation
        poses[name] = Pose(rotation, -rotation @ centre)
    cameras = {
        name: Camera(
            name,
            size,
            np.array([focal * (1 + 0.004 * i), focal * (1 + 0.0043 * i)]),
            np.array([size[0] / 2 + 4 - 3 * i, size[1] / 2 - 3 + 2 * i]),
            np.array([-0.05, 0.04, 2e-4, -1e-4, 0.0]),
        )
        for i, name in enumerate(poses)
    }
    return Rig("left", cameras, poses)


def falsify(rig: Rig, error: Error, size: float, camera: str = "right") -> Rig:
    """Return the rig with one quantity of a camera wrong: by a share, px, ° or mm as its kind has it."""
    own, pose = rig.cameras[camera], rig.cam_from_core[camera]
    focal, centre, turn, shift = own.focal_px.copy(), own.center_px.copy(), np.zeros(3), pose.translation_mm
    if error in ("focal_x", "focal_y"):
        focal[int(error == "focal_y")] *= 1 + size
    elif error == "scale":
        focal *= 1 + size
        centre = (centre + 0.5) * (1 + size) - 0.5
    elif error in ("center_x", "center_y"):
        centre[int(error == "center_y")] += size
    elif error in ("roll", "pitch"):
        turn[2 if error == "roll" else 0] = np.deg2rad(size)
    elif error == "baseline_length":
        shift = shift * (1 + size)
    else:
        shift = shift + size * np.array([-shift[1], shift[0], 0.0]) / np.linalg.norm(shift[:2])
    turned = Pose.of(turn, np.zeros(3)) @ Pose(pose.rotation, shift)
    poses = {**rig.cam_from_core, camera: turned}
    cameras = {**rig.cameras, camera: replace(own, focal_px=focal, center_px=centre)}
    return replace(rig, cameras=cameras, cam_from_core=poses)


@cache
def draw_dots(arrangement: Arrangement, period: float, seed: int) -> np.ndarray:
    """Return a float32 texture of equal round dots with a mean distance of ``period`` texels."""
    rng = np.random.default_rng(seed)
    if arrangement == "jittered":
        line = np.arange(period / 2, _TEXTURE_PX, period)
        centres = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
        centres += rng.uniform(-0.3, 0.3, centres.shape) * period
    else:
        centres = rng.uniform(0, _TEXTURE_PX, (round((_TEXTURE_PX / period) ** 2), 2))
    whole = np.rint(centres).astype(int)
    image = np.zeros((_TEXTURE_PX, _TEXTURE_PX), np.float32)
    inside = (whole < _TEXTURE_PX).all(axis=1)
    image[whole[inside, 1], whole[inside, 0]] = 1.0
    spread = period * 4 / 13 / 2.355
    return np.minimum(cv2.GaussianBlur(image, (0, 0), spread) * (2 * np.pi * spread**2), 1.0)


def cast_room(origin: np.ndarray, rays: np.ndarray, shift_mm: float = 0.0) -> np.ndarray:
    """Return (...) distances, in lengths of the rays (..., 3), to walls, floor and cupboards.

    The cupboards stand ``shift_mm`` farther to the right, as at another instant.
    """
    nearest = np.full(rays.shape[:-1], np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for normal, distance in (
            ((0.12, 0.05, 1.0), 2350.0),
            ((-1.0, 0.0, 0.9), 2900.0),
            ((0.0, 1.0, 0.25), 1150.0),
        ):
            hit = (distance - origin @ np.array(normal)) / (rays @ np.array(normal))
            nearest = np.where((hit > 0) & (hit < nearest), hit, nearest)
        for low, high in (
            ((-820.0, -150.0, 1500.0), (-330.0, 620.0, 2000.0)),
            ((-120.0, 40.0, 1250.0), (280.0, 620.0, 1700.0)),
            ((420.0, -500.0, 1750.0), (900.0, 120.0, 2100.0)),
        ):
            enter, leave = -np.inf, np.inf
            for i, moved in enumerate((shift_mm, 0.0, 0.0)):
                one, other = ((side[i] + moved - origin[i]) / rays[..., i] for side in (low, high))
                enter = np.maximum(enter, np.minimum(one, other))
                leave = np.minimum(leave, np.maximum(one, other))
            nearest = np.where((enter <= leave) & (enter > 0), np.minimum(nearest, enter), nearest)
    return nearest


def render_room(
    rig: Rig,
    arrangement: Arrangement = "jittered",
    *,
    dot_px: float = 4.0,
    noise: float = 1.5,
    seed: int = 1,
    shifts_mm: dict[str, float] | None = None,
) -> FrameSet:
    """Return 8-bit images; dots are ``dot_px`` wide and 13/4 of it apart in the core's image at 1.8 m.

    ``shifts_mm`` displaces the cupboards for some cameras: their images are of another instant.
    """
    period = 13 / 4 * dot_px * (_TEXTURE_PX / 2) / float(rig.core_camera.focal_px[0])
    texture = draw_dots(arrangement, period, seed)
    rng = np.random.default_rng(seed)
    images = {}
    for name, camera in rig.cameras.items():
        shift = (shifts_mm or {}).get(name, 0.0)
        pixels = np.stack(np.meshgrid(*(np.arange(n) for n in camera.size_px)), axis=-1)
        ideal = camera.undistort(pixels)
        pose = rig.cam_from_core[name]
        rays = np.concatenate([ideal, np.ones_like(ideal[..., :1])], axis=-1) @ pose.rotation
        points = pose.center_mm + rays * cast_room(pose.center_mm, rays, shift)[..., None]
        light = points - PROJECTOR_MM
        is_lit = cast_room(PROJECTOR_MM, light, shift) > 0.998
        texel = (light[..., :2] / light[..., 2:] * 0.5 + 0.5) * _TEXTURE_PX
        dots = cv2.remap(texture, texel.astype(np.float32), None, cv2.INTER_LINEAR)
        level = (10 + 150 * dots * is_lit) * np.square(1800 / points[..., 2])
        counts = level + rng.normal(0, noise, level.shape)
        images[name] = np.clip(np.rint(counts), 0, 255).astype(np.uint8)
    return FrameSet("000", images)


def compute_room_depth(rig: Rig) -> np.ndarray:
    """Return the (H, W) true depth on the core's undistorted grid, mm."""
    rays = rig.core_camera.rays()
    return cast_room(np.zeros(3), np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1))
