"""Guidance: what the board reached, where it is wanted next, and which camera was moved."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.calibration.detection.detect_capture import list_variants, make_two_sided_detector
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.pipeline.calibrating.guidance import (
    CELLS,
    MISSING,
    NOT_NEEDED,
    REACHED,
    RigVerdict,
    draw_ghost,
    find_moved_camera,
    make_volume_of_view,
    paint_coverage,
)
from beltscape.target.board import corner_points_mm
from tests.synthetic.boards import Print, board_poses, row_of_cameras, view

NAMES = ("cam0", "cam1", "cam2")


@pytest.fixture(scope="module")
def rig() -> Rig:
    return row_of_cameras(NAMES)


def make_verdict(rig: Rig, pose: Pose | None = None) -> RigVerdict:
    volume = make_volume_of_view(rig, (600.0, 700.0))
    return RigVerdict(rig, 8, 0.05, 0.02, 0.05, 0.0, True, (), pose, "", volume)


def sizes(rig: Rig) -> dict[str, tuple[int, int]]:
    return {name: camera.size_px for name, camera in rig.cameras.items()}


def test_cells_that_the_belt_needs_are_those_that_see_its_volume(rig):
    cells = {name: np.array(own) for name, own in paint_coverage(sizes(rig), {}, make_verdict(rig)).items()}
    assert (cells["cam0"] == MISSING).all()
    assert cells["cam0"].shape == CELLS[::-1]
    assert (cells["cam2"] == NOT_NEEDED).any()
    assert (cells["cam2"] == MISSING).mean() > 0.5
    before = np.array(paint_coverage(sizes(rig), {}, None)["cam2"])
    assert (before == MISSING).all()


def test_a_cell_is_reached_where_corners_were(rig):
    corners = np.array([[40.0, 40.0], [60.0, 40.0]])
    cells = np.array(paint_coverage(sizes(rig), {"cam0": corners}, None)["cam0"])
    assert cells[1, 1] == REACHED
    assert cells[-1, -1] == MISSING


def test_the_ghost_is_where_the_cameras_would_see_the_board(rig, charuco):
    (pose,) = board_poses(charuco, 1)
    ghost = draw_ghost(charuco, sizes(rig), "cam0", make_verdict(rig, pose), 3)
    assert set(ghost) == set(NAMES)
    for name, outline in ghost.items():
        pixels = rig.cameras[name].project((rig.cam_from_core[name] @ pose).apply(corner_points_mm(charuco)))
        low, high = np.min(outline, axis=0), np.max(outline, axis=0)
        assert (pixels >= low).all()
        assert (pixels <= high).all()


def test_before_there_is_a_rig_starting_poses_differ_from_view_to_view(rig, charuco):
    ghosts = [draw_ghost(charuco, sizes(rig), "cam0", None, taken) for taken in range(6)]
    assert all(set(ghost) == {"cam0"} for ghost in ghosts)
    outlines = [np.array(ghost["cam0"]) for ghost in ghosts]
    distances = [np.abs(a - b).max() for i, a in enumerate(outlines) for b in outlines[:i]]
    assert min(distances) > 20
    assert draw_ghost(charuco, {}, "cam0", None, 0) == {}


def see(rig: Rig, charuco, poses: list[Pose]):
    detect = make_two_sided_detector(charuco, list_variants(charuco)[0])
    views = []
    for i, pose in enumerate(poses):
        images = {
            name: view(rig.cameras[name], rig.cam_from_core[name] @ pose, charuco, Print(seed=i))
            for name in rig.cameras
        }
        found = {name: detect(image) for name, image in images.items()}
        views.append({name: own for name, own in found.items() if own})
    return views


@pytest.mark.parametrize("moved", ["", "cam1", "cam2"])
def test_the_camera_that_was_moved_is_named_and_no_other(rig, charuco, moved):
    present = dict(rig.cam_from_core)
    if moved:
        present[moved] = Pose.of([0.004, 0.0, 0.003], [1.0, 0.0, 0.0]) @ present[moved]
    views = see(Rig(rig.core, rig.cameras, present), charuco, board_poses(charuco, 2))
    assert find_moved_camera(make_verdict(rig), charuco, views, sizes(rig)) == moved
