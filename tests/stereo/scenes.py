"""Small ray-cast scenes on which the stages of the multi-view matcher are tested; the world's frame is the core's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from beltscape.core.frames import FrameSet
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.kernels import load
from beltscape.stereo.multiview.features import ConfidenceInputs, MatcherState
from beltscape.stereo.multiview.frame import MatchContext, PreparedFrame, scale_boxes
from beltscape.stereo.multiview.optimisation import LeastSquaresResult, PropagationResult
from beltscape.stereo.multiview.preparation import prepare_frame
from beltscape.stereo.multiview.surface import compute_inverse_depth_scale
from tests.stereo.raycast import look_at, make_camera, make_speckle

Solid = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Origin (3,) and rays (H, W, 3) → (H, W) distance of the hit in lengths of the ray; inf without a hit."""
DEPTH_MM = 700.0
SIZE_PX = (120, 100)
BASELINE_MM = 200.0
DOT_PX = 1.3
"""Standard deviation of the speckle's smoothing, px of the core at `DEPTH_MM`."""
_TEXEL_DOT = 1.6


def plane(depth_mm: float = DEPTH_MM, slope_u: float = 0.0, slope_v: float = 0.0) -> Solid:
    """Return the plane z = depth + slope_u x + slope_v y."""
    normal = np.array([-slope_u, -slope_v, 1.0])
    return lambda origin, rays: (depth_mm - origin @ normal) / (rays @ normal)


def sphere(depth_mm: float, radius_mm: float) -> Solid:
    """Return a sphere whose nearest point lies at this depth on the core's axis."""

    def hit(origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
        away = origin - [0, 0, depth_mm + radius_mm]
        a, b, c = (rays**2).sum(axis=-1), rays @ away, away @ away - radius_mm**2
        root = b * b - a * c
        return np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)

    return hit


def patch(depth_mm: float, x_mm: tuple[float, float], y_mm: tuple[float, float] = (-1e4, 1e4)) -> Solid:
    """Return a thin rectangle across the core's axis."""

    def hit(origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
        away = (depth_mm - origin[2]) / rays[..., 2]
        x, y = (origin[i] + away * rays[..., i] for i in (0, 1))
        inside = (x >= x_mm[0]) & (x <= x_mm[1]) & (y >= y_mm[0]) & (y <= y_mm[1])
        return np.where(inside, away, np.inf)

    return hit


def make_ring(
    angles_deg: tuple[float, ...] = (0, 90, 180, 270),
    *,
    size_px: tuple[int, int] = SIZE_PX,
    parallel: bool = False,
) -> Rig:
    """Return a rig with auxiliaries around the core, convergent or parallel."""
    poses = {"cam0": Pose.identity()}
    for i, angle in enumerate(np.deg2rad(angles_deg), start=1):
        center = BASELINE_MM * np.array([np.cos(angle), np.sin(angle), 0.02 * i])
        target = center + np.array([0.0, 0.0, 1.0]) if parallel else np.array([3.0 * i, -2.0, DEPTH_MM])
        poses[f"cam{i}"] = look_at(center, target)
    return Rig("cam0", {name: make_camera(name, size_px) for name in poses}, poses)


def cast_rays(cam: Camera, pose: Pose, solids: tuple[Solid, ...], rays: np.ndarray) -> np.ndarray:
    """Return the (H, W, 3) points, in the core's frame, that a camera sees along rays (H, W, 2)."""
    world = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1) @ pose.rotation
    away = np.minimum.reduce([solid(pose.center_mm, world) for solid in solids])
    return pose.center_mm + world * away[..., None]


def sample_speckle(points: np.ndarray, dot_mm: float) -> np.ndarray:
    """Return (H, W) float32 counts of a speckle that is projected obliquely from above."""
    at = (points[..., :2] + 0.2 * (points[..., 2:] - DEPTH_MM)) * _TEXEL_DOT / dot_mm + 600
    return cv2.remap(
        make_speckle(), at.astype(np.float32), None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
    )


def render_images(
    rig: Rig, solids: tuple[Solid, ...], *, noise: float = 0.0, seed: int = 1, dot_px: float = DOT_PX
) -> dict[str, np.ndarray]:
    """Return float32 images, in 8-bit counts, of all cameras."""
    dot_mm = dot_px * DEPTH_MM / float(rig.core_camera.focal_px[0])
    rng = np.random.default_rng(seed)
    seen = {}
    for name, cam in rig.cameras.items():
        pixels = np.stack(np.meshgrid(np.arange(cam.size_px[0]), np.arange(cam.size_px[1])), axis=-1)
        points = cast_rays(cam, rig.cam_from_core[name], solids, cam.undistort(pixels))
        image = sample_speckle(points, dot_mm)
        seen[name] = image + rng.normal(0, noise, image.shape).astype(np.float32) if noise else image
    return seen


def quantise(image: np.ndarray, dtype: type = np.uint8) -> np.ndarray:
    """Return the image of a camera of 8 or 16 bits."""
    full = np.iinfo(dtype).max
    return np.clip(np.rint(image * (full / 255)), 0, full).astype(dtype)


def compute_depth_mm(rig: Rig, solids: tuple[Solid, ...]) -> np.ndarray:
    """Return the (H, W) true depth on the core's undistorted grid."""
    cam = rig.core_camera
    return cast_rays(cam, Pose.identity(), solids, cam.rays())[..., 2]


def prepare_scene(
    rig: Rig, frame_set: FrameSet, auxiliaries: tuple[str, ...] | None = None, step: int = 1
) -> PreparedFrame:
    """Prepare a frame with a context of one thread."""
    names = rig.auxiliaries if auxiliaries is None else auxiliaries
    return prepare_frame(frame_set, MatchContext.for_grid(rig, names, step, load(), 1))


def with_context(prepared: PreparedFrame, **changes: Any) -> PreparedFrame:
    """Return the frame with other values in its context."""
    return replace(prepared, context=replace(prepared.context, **changes))


def with_scale(prepared: PreparedFrame, scale: float = 1.0) -> PreparedFrame:
    """Return the frame with distances in px of another scale."""
    windows = replace(prepared.context.windows, boxes=scale_boxes(scale), scale=scale)
    return with_context(prepared, windows=windows)


def make_inputs(prepared: PreparedFrame, solution: LeastSquaresResult) -> ConfidenceInputs:
    """Return the inputs of the confidence for a surface that costs nothing."""
    surface = solution.surface
    zero, none = np.zeros(surface.s.shape, np.float32), np.zeros(surface.s.shape, bool)
    propagated = PropagationResult(surface, zero, zero)
    return ConfidenceInputs.from_state(MatcherState(prepared, propagated, solution, {}, none, none, None))


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A frame ready for a stage, and its truth."""

    rig: Rig
    prepared: PreparedFrame
    s: np.ndarray
    """(H, W) float32 true inverse depth, px."""
    unit: float

    @property
    def auxiliaries(self) -> tuple[str, ...]:
        """Auxiliaries of the rig; all are used."""
        return self.rig.auxiliaries


def make_scene(*solids: Solid, rig: Rig | None = None, noise: float = 0.0, seed: int = 1) -> Scene:
    """Return a scene with 16-bit images of solids, prepared at full size."""
    rig = rig or make_ring()
    images = {
        name: quantise(i, np.uint16) for name, i in render_images(rig, solids, noise=noise, seed=seed).items()
    }
    unit = compute_inverse_depth_scale(rig, rig.auxiliaries)
    prepared = prepare_scene(rig, FrameSet("000", images))
    return Scene(rig, prepared, (1 / (compute_depth_mm(rig, solids) * unit)).astype(np.float32), unit)


def mask_inner(shape: tuple[int, ...], margin_px: int) -> np.ndarray:
    """Return the (H, W) mask of pixels farther than this from the border."""
    inside = np.zeros(shape, bool)
    inside[margin_px:-margin_px, margin_px:-margin_px] = True
    return inside


def mask_away_from_steps(s: np.ndarray, distance_px: int, step_px: float = 1.5) -> np.ndarray:
    """Return the (H, W) mask of pixels without a step of s within this distance."""
    window = np.ones((3, 3), np.uint8)
    step = (cv2.dilate(s, window) - cv2.erode(s, window) > step_px).astype(np.uint8)
    return cv2.dilate(step, np.ones((2 * distance_px + 1,) * 2, np.uint8)) == 0
