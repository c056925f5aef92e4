"""Poses of a calibration board in front of the cameras."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.simulate.geometry.world import Station
from beltscape.simulate.scenario import BoardSpec
from beltscape.target.board import Board, corner_points_mm

Array = NDArray[np.float64]


def sample_board_poses(
    spec: BoardSpec, board: Board, station: Station, count: int, seed: int
) -> tuple[Pose, ...]:
    """Return world_from_board of ``count`` poses, spread over the core's view, over depths and over tilts.

    Positions and depths follow a Halton-like sequence, tilts the golden angle: few frames are spread as well as many.
    """
    rng = np.random.default_rng([seed, 3])
    corners = corner_points_mm(board)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    camera = station.rig.core_camera
    start = rng.random(3)
    poses: list[Pose] = []
    for i in range(count):
        u, v, w = (start + i * np.array([0.7548776662, 0.5698402910, 0.6180339887])) % 1.0
        depth = spec.depth_mm[0] + w * (spec.depth_mm[1] - spec.depth_mm[0])
        pixel = (np.array([u, v]) - 0.5) * spec.reach * np.array(camera.size_px)
        center, facing = _place_middle(camera, pixel, depth, spec.faces_core)
        azimuth, angle = 2.399963 * i, np.deg2rad(spec.tilt_deg) * np.sqrt((i % 5 + rng.random()) / 5)
        tilt = Pose.of([angle * np.cos(azimuth), angle * np.sin(azimuth), 0.0], np.zeros(3))
        roll = Pose.of([0.0, 0.0, rng.uniform(-0.6, 0.6) + np.pi / 2 * (i % 4 == 3)], np.zeros(3))
        rotation = facing @ tilt.rotation @ roll.rotation
        core_from_board = Pose(rotation, center - rotation @ middle)
        poses.append(station.core_from_world.inverse() @ core_from_board)
    return tuple(poses)


def _place_middle(camera: Camera, pixel: Array, depth_mm: float, faces_camera: bool) -> tuple[Array, Array]:
    """Return the board's middle (3,) at a place of the image, px from its centre, and the turn (3, 3) towards it."""
    if not faces_camera:
        return np.append(pixel / camera.focal_px, 1.0) * depth_mm, np.eye(3)
    ray = np.append(camera.undistort(camera.center_px + pixel), 1.0)
    ray /= np.linalg.norm(ray)
    across = np.cross([0.0, 1.0, 0.0], ray)
    across /= np.linalg.norm(across)
    return depth_mm * ray, np.column_stack([across, np.cross(ray, across), ray])
