"""Visibility in the simulated world: rays of pixels, and whether points lie in an image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose


def compute_pixel_rays(camera: Camera, cam_from_world: Pose, *, distorted: bool) -> NDArray[np.float64]:
    """Return (H·W, 3) rays of all pixels, row by row, in the world, one millimetre long along the optical axis.

    A distance in lengths of such a ray is a depth in mm. ``distorted``: through the pixels of the image as the camera
    records it; else of its undistorted pinhole grid. NaN where the lens model has no ray.
    """
    if distorted:
        width, height = camera.size_px
        u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        plane = camera.undistort(np.stack([u, v], axis=-1).reshape(-1, 2))
    else:
        plane = camera.rays().reshape(-1, 2)
    return np.column_stack([plane, np.ones(len(plane))]) @ cam_from_world.rotation


def is_in_image(camera: Camera, cam_from_world: Pose, points_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return (N,) whether world points (N, 3) project into the image: in front of the camera and on a pixel."""
    points = cam_from_world.apply(points_mm)
    pixels = camera.project(points)
    with np.errstate(invalid="ignore"):
        is_inside = np.all((pixels >= -0.5) & (pixels < np.array(camera.size_px) - 0.5), axis=1)
    # far outside the view the lens polynomial turns back and projects points into the image that no lens images
    ideal = points[is_inside, :2] / points[is_inside, 2:]
    undistorted = camera.undistort(pixels[is_inside])
    is_inside[is_inside] = (np.abs(undistorted - ideal) < 1e-6).all(axis=1)
    return is_inside
