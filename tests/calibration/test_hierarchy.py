"""The paper's calibration hierarchy on exact and incomplete detections."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from beltscape.calibration.bundle_adjustment import adjust_bundle
from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.hierarchy import find_unsynchronised_pairs, solve_hierarchy
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.pose import Pose
from beltscape.core.progress import Silent
from beltscape.target.board import corner_points_mm
from tests.optional import require
from tests.synthetic.detections import make_detections, project_corners

FRAMES = range(12)


def test_without_noise_the_rig_is_recovered(rig, board, poses):
    reporter = Silent()
    found = solve_hierarchy(make_detections(rig, board, poses), board, "b", reporter).rig
    assert (found.core, list(found.cameras)) == ("b", ["b", "a", "c", "d"])
    for name in rig.cameras:
        offset = found.cam_from_core[name].inverse() @ rig.relative_pose(name, "b")
        assert offset.angle_deg < 1e-3
        assert np.linalg.norm(offset.translation_mm) < 0.01
    assert reporter.warnings == []


def test_the_default_core_is_a_central_camera(rig, board, poses):
    assert solve_hierarchy(
        make_detections(rig, board, poses, noise_px=0.05), board, None, Silent()
    ).rig.core in ("b", "c")


def test_the_network_is_optimised_and_keeps_the_initial_one(rig, board, poses):
    chain = solve_hierarchy(make_detections(rig, board, poses, noise_px=0.1), board, "b", Silent())
    before, after = require(chain.network.initial), chain.network
    assert [e.pair for e in before.path_errors] == [("a", "c"), ("a", "d"), ("c", "d")]
    assert len(after.path_errors) == 6
    assert len(after.loop_errors) == 4
    assert chain.rig.cam_from_core["c"] is after.cam_from_core["c"] is not before.cam_from_core["c"]
    left = {e.pair: e.translation_mm for e in after.path_errors}
    assert sum(left[e.pair] for e in before.path_errors) < sum(e.translation_mm for e in before.path_errors)


def test_a_camera_that_shares_frames_only_with_an_auxiliary_is_associated_through_it(rig, board, poses):
    frames = {"a": range(8), "b": FRAMES, "c": range(8, 12), "d": ()}
    reporter = Silent()
    chain = solve_hierarchy(make_detections(rig, board, poses, seen_by=frames), board, "a", reporter)
    assert chain.network.paths["c"] == ("a", "b", "c")
    offset = chain.rig.cam_from_core["c"].inverse() @ rig.relative_pose("c", "a")
    assert np.linalg.norm(offset.translation_mm) < 0.02
    assert reporter.warnings == [
        "camera d sees the board in 0 of 12 images; at least 3 tilted views are needed; going on without d"
    ]


def test_a_camera_without_shared_views_is_reported_and_left_out(rig, board, poses):
    frames = {"a": range(7), "b": range(7), "c": range(7, 12), "d": range(7)}
    reporter = Silent()
    chain = solve_hierarchy(make_detections(rig, board, poses, seen_by=frames), board, None, reporter)
    assert set(chain.rig.cameras) == {"a", "b", "d"}
    assert reporter.warnings == ["camera c shares no view of the board with a, b, d; going on without it"]


@pytest.mark.parametrize(
    ("frames", "core", "message"),
    [
        (
            {"a": range(4), "b": range(4, 8), "c": range(8, 12), "d": ()},
            None,
            "a, b, c: no view of the board is shared with another camera; "
            "show the board to two cameras in the same frame",
        ),
        (
            {"a": range(4), "b": range(4), "c": (), "d": range(2)},
            "d",
            "camera d sees the board in 2 of 12 images; at least 3 tilted views are needed; "
            "it is the core camera: choose another with --core",
        ),
        (
            {"a": range(6), "b": range(6), "c": range(6), "d": range(6, 12)},
            "d",
            "d: no view of the board is shared with another camera; "
            "show the board to two cameras in the same frame",
        ),
    ],
)
def test_views_that_do_not_determine_a_rig_are_refused(rig, board, poses, frames, core, message):
    with pytest.raises(CalibrationError) as error:
        solve_hierarchy(make_detections(rig, board, poses, seen_by=frames), board, core, Silent())
    assert str(error.value) == message


def test_cameras_that_are_not_triggered_together_are_detected(rig, board, poses):
    """Camera b photographs a board that has moved on by a few millimetres, differently in every frame."""
    own = make_detections(rig, board, poses, noise_px=0.05)
    rng = np.random.default_rng(2)
    late = {}
    for i, pose in enumerate(poses):
        moved = Pose(pose.rotation, pose.translation_mm + rng.uniform(-4, 4, 3))
        late[f"{i:02d}"] = project_corners(
            rig, "b", moved, corner_points_mm(board), rng.normal(0, 0.05, (35, 2))
        )
    skewed = BoardDetections(own.sizes_px, {**own.views, "b": late}, own.images)
    pairs = find_unsynchronised_pairs(solve_hierarchy(skewed, board, "a", Silent()))
    assert {(p.first, p.second) for p in pairs} == {("a", "b"), ("b", "c"), ("b", "d")}
    assert find_unsynchronised_pairs(solve_hierarchy(own, board, "a", Silent())) == []


def test_the_same_detections_give_the_same_bytes(rig, board, poses):
    own = make_detections(rig, board, poses, noise_px=0.1)
    turned = own.restrict(reversed(rig.cameras), own.frames)
    rigs = [solve_hierarchy(s, board, "b", Silent()).rig for s in (own, own, turned)]
    for name in rig.cameras:
        assert len({r.cameras[name].focal_px.tobytes() for r in rigs}) == 1
        assert len({r.cam_from_core[name].translation_mm.tobytes() for r in rigs[:2]}) == 1


def test_the_number_of_opencv_threads_is_restored(rig, board, poses):
    before = cv2.getNumThreads()
    two = make_detections(rig, board, poses[:5], noise_px=0.1).restrict("ab", [f"{i:02d}" for i in range(5)])
    solve_hierarchy(two, board, None, Silent())
    assert cv2.getNumThreads() == before


def test_a_mere_start_leads_to_the_same_rig(rig, board, poses):
    """Pairs with the core only, and no optimisation of the network: the joint adjustment ends where it did."""
    seen = make_detections(rig, board, poses, 0.05)
    whole = solve_hierarchy(seen, board, "b", Silent())
    start = solve_hierarchy(seen, board, "b", Silent(), is_start=True)
    assert {frozenset((pair.first, pair.second)) for pair in start.network.pairs} == {
        frozenset(("b", name)) for name in "acd"
    }
    assert (start.network.path_errors, start.network.loop_errors) == ((), ())
    first, second = (adjust_bundle(each, board).rig for each in (whole, start))
    for name in rig.cameras:
        np.testing.assert_allclose(
            first.cam_from_core[name].center_mm, second.cam_from_core[name].center_mm, atol=1e-3
        )
        np.testing.assert_allclose(first.cameras[name].focal_px, second.cameras[name].focal_px, rtol=1e-6)


def test_a_mere_start_takes_all_pairs_where_the_core_does_not_see_all_boards(rig, board, poses):
    seen_by = {"a": range(6), "b": range(12), "c": range(6, 12), "d": range(12)}
    seen = make_detections(rig, board, poses, 0.05, seen_by=seen_by)
    start = solve_hierarchy(seen, board, "a", Silent(), is_start=True)
    assert set(start.rig.cameras) == set(rig.cameras)
    assert len(start.network.paths["c"]) == 3
    assert len(start.network.pairs) == 5
