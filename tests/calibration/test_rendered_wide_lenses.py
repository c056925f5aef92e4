"""Images through wide lenses: rendering, detection and the choice of the lens model, against the exact lens."""

from __future__ import annotations

import numpy as np

from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.detection.detector import PrintVariant, make_detector
from beltscape.calibration.intrinsics.lens_choice import calibrate_with_model
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.target.board import CharucoBoard, corner_points_mm
from tests.synthetic.boards import Print, view

SIZE_PX = (480, 400)
BOARD = CharucoBoard(squares=(7, 5), square_mm=40, marker_mm=30, dictionary="DICT_4X4_50")
VIEWS, REACH_PX = 12, np.array([150, 115])
FISHEYE = Camera(
    "c",
    SIZE_PX,
    np.full(2, 255.0),
    np.array([243.0, 197.0]),
    np.array([0.02, -0.01, 0.003, -0.001]),
    "fisheye",
)
"""A lens of 140° across the diagonal."""


def place_board(lens: Camera, pixel: np.ndarray, distance_mm: float, turn: np.ndarray) -> Pose:
    """Return cam_from_board, the board's middle on a pixel's ray, turned towards the camera and then by ``turn``."""
    ray = np.append(lens.undistort(pixel), 1.0)
    ray /= np.linalg.norm(ray)
    across = np.cross([0.0, 1.0, 0.0], ray)
    across /= np.linalg.norm(across)
    rotation = np.column_stack([across, np.cross(ray, across), ray]) @ Pose.of(turn, np.zeros(3)).rotation
    middle = np.array([*BOARD.squares, 0]) / 2 * BOARD.square_mm
    return Pose(rotation, distance_mm * ray - rotation @ middle)


def test_the_lens_of_rendered_views_is_found():
    true = FISHEYE
    rng, detect = np.random.default_rng(2), make_detector(BOARD, PrintVariant())
    views = {}
    for i in range(VIEWS):
        turn = 2.4 * i
        pixel = true.center_px + REACH_PX * np.sqrt((i + 0.5) / VIEWS) * np.array(
            [np.cos(turn), np.sin(turn)]
        )
        pose = place_board(true, pixel, rng.uniform(260, 360), rng.uniform(-0.6, 0.6, 3))
        corners = detect(view(true, pose, BOARD, Print(seed=i)))
        if corners is not None:
            views[f"{i:02d}"] = corners
    assert len(views) >= VIEWS - 2
    seen = BoardDetections({"c": SIZE_PX}, {"c": views}, {"c": VIEWS})
    found, choice = calibrate_with_model("c", seen, corner_points_mm(BOARD))
    assert choice.model == found.camera.model == "fisheye"
    assert found.rms_px < 0.06
    pixels = np.concatenate([corners.pixels for corners in views.values()])
    rays = np.column_stack([true.undistort(pixels), np.ones(len(pixels))])
    apart = np.linalg.norm(found.camera.project(rays) - pixels, axis=1)
    assert np.sqrt((apart**2).mean()) < 0.5
    assert np.abs(found.camera.focal_px / true.focal_px - 1).max() < 0.01
