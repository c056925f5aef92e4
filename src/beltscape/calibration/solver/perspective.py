"""Pose of a board from one view with known intrinsics (perspective-n-point)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose

Array = NDArray[np.float64]

MIN_POINTS = 4
"""Least number of coplanar points that determine a pose."""


def count_usable_points(camera: Camera, pixels: Array) -> int:
    """Return how many pixels (n, 2) lie within the domain of validity of a camera's lens."""
    return int(np.isfinite(camera.undistort(pixels)).all(axis=1).sum())


def fit_view_pose(camera: Camera, points_mm: Array, pixels: Array, *, refine: bool = False) -> Pose:
    """Return cam_from_board from points (n, 3) and their pixels (n, 2).

    Pixels beyond the lens's domain of validity are left out. ``refine`` minimises the errors in undistorted
    coordinates after the closed solution.

    Raises
    ------
    CalibrationError
        When fewer than four pixels lie within the domain.
    """
    ideal = camera.undistort(pixels)
    is_usable = np.isfinite(ideal).all(axis=1)
    if is_usable.sum() < MIN_POINTS:
        raise CalibrationError(
            f"camera {camera.name}: only {is_usable.sum()} of {len(pixels)} corners of a view lie where its lens "
            f"model {camera.model} is valid; calibrate it with a model for wider lenses"
        )
    points, ideal = points_mm[is_usable], ideal[is_usable]
    _, rotation, shift = cv2.solvePnP(points, ideal, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
    if refine:
        rotation, shift = cv2.solvePnPRefineLM(points, ideal, np.eye(3), None, rotation, shift)
    return Pose.of(rotation, shift)
