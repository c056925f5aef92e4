"""Depth map → points with normals and colour."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.camera import Camera
from beltscape.core.cloud import PointCloud
from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.core.frames import Image

_WINDOW_PX = 5
_STEP = 0.01
"""Relative depth difference within the window beyond which it reaches over a step."""
_PERCENTILE = 99.5


def cloud_from_depth(depth: DepthMap, camera: Camera, image: Image | None) -> PointCloud:
    """Points of the measured pixels in the core camera's frame (the paper's Eq. 25).

    Parameters
    ----------
    depth
        (H, W) on the camera's undistorted pinhole grid.
    camera
        The core camera.
    image
        Its distorted image, for the colour; without one the points are mid grey.

    Raises
    ------
    InputError
        When depth map or image do not have the camera's size.
    """
    width, height = camera.size_px
    if depth.depth_mm.shape != (height, width):
        raise InputError(
            f"the depth map is {depth.depth_mm.shape[1]}×{depth.depth_mm.shape[0]} px, but {camera.name} has "
            f"{width}×{height}"
        )
    measured = depth.measured
    z = depth.depth_mm[measured]
    rays = camera.rays().astype(np.float32)[measured]
    points = np.empty((len(z), 3), np.float32)
    points[:, :2] = rays * z[:, None]
    points[:, 2] = z
    return PointCloud(
        points_mm=points,
        normals=_normals(depth.depth_mm, camera)[measured],
        colors=_colors(image, camera)[measured],
        sigma_mm=depth.sigma_mm[measured],
    )


def undistorted(image: Image, camera: Camera) -> Image:
    """The image on the camera's pinhole grid; black where the camera did not look."""
    pixels = (camera.distort(camera.rays()) * camera.focal_px + camera.center_px).astype(np.float32)
    return np.asarray(cv2.remap(image, pixels, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT))


def _colors(image: Image | None, camera: Camera) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 RGB, stretched so that its bright parts are white."""
    width, height = camera.size_px
    if image is None:
        return np.full((height, width, 3), 128, np.uint8)
    if image.shape[:2] != (height, width):
        raise InputError(
            f"the image is {image.shape[1]}×{image.shape[0]} px, but {camera.name} has {width}×{height}"
        )
    straight = undistorted(image, camera)
    top = max(float(np.percentile(straight, _PERCENTILE)), 1.0)
    eight = np.clip(straight * np.float32(255.0 / top), 0, 255).astype(np.uint8)
    return np.repeat(eight[..., None], 3, axis=2) if eight.ndim == 2 else np.ascontiguousarray(eight[..., :3])


def _normals(depth_mm: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """(H, W, 3) float32 unit normals towards the camera; NaN where the window gives no plane.

    With w = 1/Z a plane is linear in the pixel, w = a·x + b·y + c with rays (x, y, 1), and its normal is
    (a, b, c): so the gradient of w over a window of its measured pixels gives it without bias.
    """
    with np.errstate(invalid="ignore"):
        inverse = 1.0 / depth_mm
    du, dv = _gradient(inverse, axis=1), _gradient(inverse, axis=0)
    rays = camera.rays().astype(np.float32)
    a, b = du * np.float32(camera.focal_px[0]), dv * np.float32(camera.focal_px[1])
    normal = np.stack([a, b, inverse - a * rays[..., 0] - b * rays[..., 1]], axis=-1)
    return (-normal / np.linalg.norm(normal, axis=-1, keepdims=True)).astype(np.float32)


def _gradient(values: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Mean of the differences of neighbours on one surface within the window; NaN without any."""
    step = np.diff(values, axis=axis)
    pad = [(0, 0), (0, 0)]
    pad[axis] = (0, 1)
    later = np.pad(step, pad, constant_values=np.nan)
    with np.errstate(invalid="ignore"):
        usable = np.abs(later) < _STEP * values
    window = (_WINDOW_PX - 1, _WINDOW_PX) if axis == 1 else (_WINDOW_PX, _WINDOW_PX - 1)
    # an even window of differences is centred on the pixel between its middle two
    anchor = (window[0] // 2, window[1] // 2)
    total = cv2.boxFilter(np.where(usable, later, 0), -1, window, anchor=anchor, normalize=False)
    count = cv2.boxFilter(usable.astype(np.float32), -1, window, anchor=anchor, normalize=False)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(count > 0.5, total / count, np.nan).astype(np.float32)
