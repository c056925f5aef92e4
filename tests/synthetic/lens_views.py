"""Views of a bent board through wide lenses, by one camera and by a rig: exact corners with noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import BoardDetections, Corners, has_planar_extent
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.target.board import Chessboard, corner_points_mm

BOARD = Chessboard(corners=(14, 9), square_mm=30)
BOARD_MM = corner_points_mm(BOARD)
SIZE_PX = (1280, 1024)
MIDDLE_PX = (np.array(SIZE_PX) - 1) / 2
RATIONAL = [0.9, 0.2, 3e-4, -2e-4, 0.01, 1.25, 0.45, 0.05]
"""A lens that sees 105° across with `RATIONAL_FOCAL_PX`."""
RATIONAL_FOCAL_PX = 726.0
BROWN = Camera("c", SIZE_PX, np.full(2, 1000.0), MIDDLE_PX + 4.0, np.array([-0.25, 0.12, 3e-4, -2e-4, -0.02]))


def make_rational(name: str = "c", rng: np.random.Generator | None = None) -> Camera:
    """Return a camera with a rational lens of 105°; with ``rng`` one of many alike."""
    lens, focal, off = np.array(RATIONAL), RATIONAL_FOCAL_PX, np.array([5.0, -4.0])
    if rng is not None:
        lens[[0, 5]] *= 1 + rng.normal(0, 0.01, 2)
        focal, off = focal * (1 + rng.normal(0, 0.005)), rng.normal(0, 6, 2)
    return Camera(name, SIZE_PX, np.full(2, focal), MIDDLE_PX + off, lens, "rational")


def bend_board(rms_mm: float) -> NDArray[np.float64]:
    """Return the corners (P, 3) of the board, bent by an RMS height."""
    x, y, _ = (2 * (BOARD_MM - BOARD_MM.mean(axis=0)) / np.ptp(BOARD_MM, axis=0).max()).T
    height = x**2 + 0.5 * x * y
    height -= height.mean()
    return BOARD_MM + np.outer(rms_mm * height / height.std(), [0.0, 0.0, 1.0])


def project_board(
    camera: Camera, points: NDArray[np.float64], noise_px: float, rng: np.random.Generator
) -> Corners | None:
    """Return the corners of a board at points (P, 3) in the camera's frame; None with too few in the image."""
    with np.errstate(invalid="ignore"):
        pixels = camera.project(points)
        inside = (points[:, 2] > 0) & ((pixels >= 0) & (pixels <= np.array(SIZE_PX) - 1)).all(axis=1)
    ids = np.flatnonzero(inside)
    if len(ids) < 20 or not has_planar_extent(BOARD_MM[ids]):
        return None
    return Corners(ids, pixels[ids] + rng.normal(0, noise_px, (len(ids), 2)))


def view_from(
    camera: Camera, place: Callable[[int, np.random.Generator], NDArray[np.float64]], seed: int,
    bend_mm: float = 0.0, count: int = 24, noise_px: float = 0.05,
) -> BoardDetections:  # fmt: skip
    """Return views of boards turned towards the camera, with their middles at the pixels that ``place`` gives."""
    rng, shape, views = np.random.default_rng(seed), bend_board(bend_mm), dict[str, Corners]()
    while len(views) < count:
        ray = np.append(camera.undistort(place(len(views), rng)[None])[0], 1.0)
        if not np.isfinite(ray).all():
            continue
        ray /= np.linalg.norm(ray)
        across = np.cross([0, 1, 0], ray) / np.linalg.norm(np.cross([0, 1, 0], ray))
        facing = np.column_stack([across, np.cross(ray, across), ray])
        turn = Pose.of(rng.uniform(-0.6, 0.6, 3) * [1, 1, 0.5], np.zeros(3)).rotation
        distance_mm = 390 * camera.focal_px[0] / (0.3 * SIZE_PX[0] * rng.uniform(0.7, 1.3))
        points = (shape - BOARD_MM.mean(axis=0)) @ (facing @ turn).T + distance_mm * ray
        seen = project_board(camera, points, noise_px, rng)
        if seen is not None:
            views[f"{len(views):02d}"] = seen
    return BoardDetections({camera.name: SIZE_PX}, {camera.name: views}, {camera.name: count})


def place_edges_together(seed: int) -> Callable[[int, np.random.Generator], NDArray[np.float64]]:
    """Return places in the image's middle, but for four views one after the other at its edge."""
    first = 4 * (seed % 6)

    def place(view: int, rng: np.random.Generator) -> NDArray[np.float64]:
        if first <= view < first + 4:
            angle = rng.uniform(0, 2 * np.pi)
            return MIDDLE_PX + np.array([520 * np.cos(angle), 400 * np.sin(angle)])
        return MIDDLE_PX + rng.uniform(-0.175, 0.175, 2) * SIZE_PX

    return place


def place_everywhere(_view: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a place anywhere in the image."""
    return rng.uniform(0, 1, 2) * SIZE_PX


def make_wide_rig(seed: int, count: int = 4) -> Rig:
    """Return cameras with rational lenses in a ring, turned towards its axis."""
    rng, poses, cameras = np.random.default_rng(seed), dict[str, Pose](), dict[str, Camera]()
    for i in range(count):
        angle = 2 * np.pi * i / count
        centre = np.array([180 * np.cos(angle), 140 * np.sin(angle), rng.normal(0, 5)])
        turn = 0.6 * np.arctan2([-centre[1], centre[0], 0], 600)
        rotation = Pose.of(turn, np.zeros(3)).rotation.T
        poses[f"c{i}"] = Pose(rotation, -rotation @ centre)
        cameras[f"c{i}"] = make_rational(f"c{i}", rng)
    core = poses["c0"].inverse()
    return Rig("c0", cameras, {name: pose @ core for name, pose in poses.items()})


def see_together(
    rig: Rig, seed: int, bend_mm: float, count: int = 16, noise_px: float = 0.02, reach_mm: float = 200.0,
    depths_mm: tuple[float, float] = (350.0, 700.0),
) -> BoardDetections:  # fmt: skip
    """Return the views of boards before a ring of cameras, all over their images."""
    rng, shape = np.random.default_rng(seed + 100), bend_board(bend_mm)
    views: dict[str, dict[str, Corners]] = {name: {} for name in rig.cameras}
    for i in range(count):
        turn = Pose.of([*rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.3, 0.3)], np.zeros(3)).rotation
        at = np.array(
            [
                -180 + rng.uniform(-reach_mm, reach_mm),
                rng.uniform(-reach_mm, reach_mm),
                rng.uniform(*depths_mm),
            ]
        )
        pose = Pose(turn, at - turn @ BOARD_MM.mean(axis=0))
        for name, camera in rig.cameras.items():
            seen = project_board(camera, (rig.cam_from_core[name] @ pose).apply(shape), noise_px, rng)
            if seen is not None:
                views[name][f"{i:02d}"] = seen
    return BoardDetections(dict.fromkeys(rig.cameras, SIZE_PX), views, dict.fromkeys(rig.cameras, count))
