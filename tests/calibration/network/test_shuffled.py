"""Cameras whose images carry the names of other instants are reported, for any permutation of the names."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.intrinsics.zhang import calibrate_camera
from beltscape.calibration.network.synchronisation import find_frame_misfits
from beltscape.target.board import corner_points_mm
from tests.synthetic.boards import board_poses
from tests.synthetic.detections import make_detections
from tests.thorough import list_cases

FRAMES = 10


@pytest.fixture(scope="module")
def own(rig, board):
    return make_detections(rig, board, board_poses(board, FRAMES, seed=7), 0.1)


def report_cameras(
    own: BoardDetections, rig, board, camera: str, source: dict[int, int]
) -> list[tuple[str, int | None]]:
    """Return the cameras reported if one camera's image ``source[k]`` carries the name of frame k."""
    views = {f"{k:02d}": own.views[camera][f"{i:02d}"] for k, i in sorted(source.items())}
    mixed = BoardDetections(own.sizes_px, {**own.views, camera: views}, own.images)
    points = corner_points_mm(board)
    alone = {name: calibrate_camera(name, mixed, points, known=rig.cameras[name]) for name in mixed.cameras}
    return [(m.camera, m.shift) for m in find_frame_misfits(alone, [f"{k:02d}" for k in range(FRAMES)])]


@pytest.mark.parametrize("camera", list_cases("abd", "b"))
@pytest.mark.parametrize("shift", list_cases([-3, -2, -1, 0, 1, 2, 3], {-2, 0, 1, 3}))
@pytest.mark.parametrize("around", [False, True], ids=["cut off", "going round"])
def test_a_shifted_camera_is_reported_with_its_shift(own, rig, board, camera, shift, around):
    source = {k: (k - shift) % FRAMES for k in range(FRAMES) if around or 0 <= k - shift < FRAMES}
    assert report_cameras(own, rig, board, camera, source) == ([(camera, shift)] if shift else [])


@pytest.mark.parametrize("camera", list_cases("abd", "b"))
@pytest.mark.parametrize("lost", [0, 2])
def test_a_camera_in_reversed_order_is_reported_as_such(own, rig, board, camera, lost):
    """Also where the first frames after the renaming show no board."""
    source = {k: FRAMES - 1 - k for k in range(lost, FRAMES)}
    views = {f"{k:02d}": own.views[camera][f"{i:02d}"] for k, i in source.items()}
    mixed = BoardDetections(own.sizes_px, {**own.views, camera: views}, own.images)
    points = corner_points_mm(board)
    alone = {name: calibrate_camera(name, mixed, points, known=rig.cameras[name]) for name in mixed.cameras}
    (found,) = find_frame_misfits(alone, [f"{k:02d}" for k in range(FRAMES)])
    assert (found.camera, found.shift, found.is_reversed) == (camera, None, True)
    assert f"camera {camera}: its frames are in the reversed order against" in found.describe()


@pytest.mark.parametrize("seed", list_cases(range(8), {0, 3}))
def test_a_shuffled_camera_is_reported(own, rig, board, seed):
    order = np.random.default_rng(seed).permutation(FRAMES)
    camera = "abcd"[seed % 4]
    assert report_cameras(own, rig, board, camera, dict(enumerate(order.tolist()))) == [(camera, None)]


def test_two_shifted_cameras_of_four_are_both_reported(rig, board, own):
    mixed = BoardDetections(own.sizes_px, own.views, own.images)
    for camera in "cd":
        views = {f"{k:02d}": mixed.views[camera][f"{k - 1:02d}"] for k in range(1, FRAMES)}
        mixed = BoardDetections(mixed.sizes_px, {**mixed.views, camera: views}, mixed.images)
    points = corner_points_mm(board)
    alone = {name: calibrate_camera(name, mixed, points, known=rig.cameras[name]) for name in mixed.cameras}
    found = find_frame_misfits(alone, [f"{k:02d}" for k in range(FRAMES)])
    # two against two: those with the first camera are taken for right
    assert [(m.camera, m.shift, m.others) for m in found] == [("c", 1, ("a", "b")), ("d", 1, ("a", "b"))]


def test_two_shuffled_cameras_are_both_reported(rig, board, own):
    views = dict(own.views)
    for camera, seed in (("b", 1), ("d", 2)):
        order = np.random.default_rng(seed).permutation(FRAMES)
        views[camera] = {f"{k:02d}": own.views[camera][f"{i:02d}"] for k, i in enumerate(order)}
    mixed = BoardDetections(own.sizes_px, views, own.images)
    points = corner_points_mm(board)
    alone = {name: calibrate_camera(name, mixed, points, known=rig.cameras[name]) for name in mixed.cameras}
    found = find_frame_misfits(alone, [f"{k:02d}" for k in range(FRAMES)])
    assert [(m.camera, m.others) for m in found] == [("b", ("a", "c")), ("d", ("a", "c"))]
