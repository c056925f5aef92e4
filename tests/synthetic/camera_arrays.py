"""Arrays of like cameras before a large board: exact corners of a board that may bend, for tests of weak views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.target.board import Chessboard, corner_points_mm

BOARD = Chessboard(corners=(14, 9), square_mm=40)
SIZE_PX = (1280, 1024)
FOCAL_PX = 1058.0
DISTANCE_MM = 800.0
WIDE_LENSES = {
    "fisheye": (420.0, [0.02, -0.01, 0.003, -0.001]),
    "rational": (560.0, [0.9, 0.2, 3e-4, -2e-4, 0.01, 1.25, 0.45, 0.05]),
}
"""Focal lengths, px, and coefficients of lenses that see 150° and 115° across the diagonal."""


def like_cameras(count: int, seed: int, convergence: float = 1.0) -> Rig:
    """Return cameras of one type in rows of four, aimed at one point (1) or parallel (0)."""
    rng = np.random.default_rng(seed)
    poses: list[Pose] = []
    for i in range(count):
        x, y = 60.0 * (i % 4 - 1.5), 60.0 * (i // 4 - 0.5)
        turn = convergence * np.array([-np.arctan2(y, 700), np.arctan2(x, 700), 0])
        rotation = Pose.of(turn + convergence * rng.normal(0, 0.02, 3), np.zeros(3)).rotation
        poses.append(Pose(rotation, -rotation @ np.array([x, y, rng.normal(0, 3)])))
    core = poses[0].inverse()
    names = [f"c{i:02d}" for i in range(count)]
    return Rig(
        names[0],
        {name: _make_camera(name, rng) for name in names},
        {name: pose @ core for name, pose in zip(names, poses, strict=True)},
    )


def _make_camera(name: str, rng: np.random.Generator) -> Camera:
    middle = (np.array(SIZE_PX) - 1) / 2
    return Camera(
        name, SIZE_PX, FOCAL_PX * (1 + rng.normal(0, 0.003)) * np.array([1, 1 + rng.normal(0, 5e-4)]),
        middle + rng.normal(0, 8, 2), np.array([-0.1 + rng.normal(0, 0.003), 0.08, *rng.normal(0, 3e-4, 2), 0.0]),
    )  # fmt: skip


def widen(rig: Rig, model: str, seed: int) -> Rig:
    """Return the array with wide lenses of a model."""
    rng, (focal_px, lens) = np.random.default_rng(seed), WIDE_LENSES[model]
    cameras = {
        name: replace(
            camera, focal_px=np.full(2, focal_px * (1 + rng.normal(0, 0.003))), distortion=np.array(lens),
            model=model,
        )
        for name, camera in rig.cameras.items()
    }  # fmt: skip
    return replace(rig, cameras=cameras)


def boards_close(count: int, seed: int) -> list[Pose]:
    """Return core_from_board of boards close before the core, all over a wide view."""
    rng, middle, poses = np.random.default_rng(seed), corner_points_mm(BOARD).mean(axis=0), list[Pose]()
    for _ in range(count):
        turn = Pose.of([*rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.3, 0.3)], np.zeros(3)).rotation
        at = rng.uniform([-250, -200, 300], [250, 200, 520])
        poses.append(Pose(turn, at - turn @ middle))
    return poses


def boards_before(rig: Rig, count: int, tilt_rad: float, seed: int) -> list[Pose]:
    """Return core_from_board of boards before the array, tilted by up to an angle."""
    rng = np.random.default_rng(seed)
    middle, core = corner_points_mm(BOARD).mean(axis=0), rig.cam_from_core[rig.core]
    forward = np.mean([pose.rotation[2] for pose in rig.cam_from_core.values()], axis=0)
    centre = np.mean([pose.center_mm for pose in rig.cam_from_core.values()], axis=0)
    poses: list[Pose] = []
    for i in range(count):
        azimuth, angle = 2.4 * i + rng.uniform(0, 0.5), tilt_rad * rng.uniform(0.4, 1)
        turn = Pose.of(
            [angle * np.cos(azimuth), angle * np.sin(azimuth), rng.uniform(-0.2, 0.2)], np.zeros(3)
        )
        facing = _turn_towards(forward) @ turn.rotation
        at = centre + DISTANCE_MM * forward / np.linalg.norm(forward) + rng.uniform(-60, 60, 3)
        poses.append(core @ Pose(facing, at - facing @ middle))
    return poses


def _turn_towards(forward: np.ndarray) -> np.ndarray:
    """Return the smallest rotation of the z axis onto a direction."""
    axis = np.cross([0, 0, 1.0], forward / np.linalg.norm(forward))
    sine = float(np.linalg.norm(axis))
    return Pose.of(axis / max(sine, 1e-12) * np.arcsin(min(sine, 1.0)), np.zeros(3)).rotation


def detect(
    rig: Rig, poses: Sequence[Pose], noise_px: float, seed: int, bend_mm: NDArray[np.float64] | float = 0.0
) -> BoardDetections:
    """Return the corners of a board that bends by ``bend_mm`` (in each frame) in all cameras' images."""
    rng = np.random.default_rng(seed)
    flat = corner_points_mm(BOARD)
    x, y, _ = (2 * (flat - flat.mean(axis=0)) / np.ptp(flat, axis=0).max()).T
    shape = np.stack([0 * x, 0 * x, 0.8 * x**2 + 0.5 * x * y], axis=1)
    views: dict[str, dict[str, Corners]] = {name: {} for name in rig.cameras}
    for i, (pose, bend) in enumerate(zip(poses, np.broadcast_to(bend_mm, len(poses)), strict=True)):
        for name, camera in rig.cameras.items():
            points = (rig.cam_from_core[name] @ pose).apply(flat + bend * shape)
            pixels = camera.project(points) + rng.normal(0, noise_px, (len(flat), 2))
            inside = ((pixels >= 0) & (pixels <= np.array(camera.size_px) - 1)).all(axis=1)
            views[name][f"{i:02d}"] = Corners(np.flatnonzero(inside).astype(np.int64), pixels[inside])
    sizes = {name: camera.size_px for name, camera in rig.cameras.items()}
    return BoardDetections(sizes, views, dict.fromkeys(rig.cameras, len(poses)))
