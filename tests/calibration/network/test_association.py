"""Multi-camera association: the path of least variance to each camera, and its misclosure."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.intrinsics.zhang import calibrate_camera
from beltscape.calibration.network.association import associate_cameras, find_groups, select_core
from beltscape.calibration.network.pairs import Pair, calibrate_pairs
from beltscape.calibration.network.pose_chains import exp
from beltscape.core.geometry.pose import Pose
from beltscape.core.progress import Silent
from beltscape.target.board import corner_points_mm
from tests.synthetic.detections import make_detections
from tests.thorough import count_examples

COVARIANCE = np.diag(np.repeat([1e-4, 0.1], 3) ** 2)


def pair(rig, first: str, second: str, rms_px: float = 0.1, corners: int = 100) -> Pair:
    return Pair(first, second, rig.relative_pose(second, first), rms_px, ("00",), corners, COVARIANCE)


def make_empty_detections(rig) -> BoardDetections:
    return BoardDetections({n: c.size_px for n, c in rig.cameras.items()}, {n: {} for n in rig.cameras}, {})


@pytest.mark.parametrize("core", ["a", "b", "c", "d"])
def test_every_camera_is_associated_with_the_core(rig, core):
    pairs = [pair(rig, *names) for names in (("a", "b"), ("b", "c"), ("d", "c"))]
    network = associate_cameras(core, pairs)
    assert set(network.cam_from_core) == set(rig.cameras)
    for name, pose in network.cam_from_core.items():
        expected = rig.relative_pose(name, core)
        np.testing.assert_allclose(pose.rotation, expected.rotation, atol=1e-12)
        np.testing.assert_allclose(pose.translation_mm, expected.translation_mm, atol=1e-9)
    np.testing.assert_array_equal(network.cam_from_core[core].rotation, np.eye(3))


def test_a_camera_that_only_another_auxiliary_sees_is_reached_through_it(rig):
    network = associate_cameras("a", [pair(rig, "a", "b"), pair(rig, "b", "c"), pair(rig, "c", "d")])
    assert network.paths == {"a": ("a",), "b": ("a", "b"), "c": ("a", "b", "c"), "d": ("a", "b", "c", "d")}
    assert network.path_errors == ()


def test_the_path_with_the_least_variance_is_selected(rig):
    steps = [pair(rig, "a", "b"), pair(rig, "b", "c")]
    good = associate_cameras("a", [*steps, pair(rig, "a", "c", rms_px=0.12)])
    bad = associate_cameras("a", [*steps, pair(rig, "a", "c", rms_px=0.5)])
    few = associate_cameras("a", [*steps, pair(rig, "a", "c", corners=20)])
    assert good.paths["c"] == ("a", "c")
    assert bad.paths["c"] == few.paths["c"] == ("a", "b", "c")


def test_path_errors_measure_the_misclosure(rig):
    off = Pose.of([0.0, 0.0, np.deg2rad(0.5)], [0, 0, 0])
    twisted = Pair("b", "c", off @ rig.relative_pose("c", "b"), 0.1, ("00",), 100, COVARIANCE)
    network = associate_cameras("a", [pair(rig, "a", "b"), pair(rig, "a", "c"), twisted])
    (error,) = network.path_errors
    assert error.pair == ("b", "c")
    assert error.rotation_deg == pytest.approx(0.5)
    assert error.translation_mm == pytest.approx(0.0, abs=1e-9)  # a twist about c's own centre
    moved = Pair(
        "b",
        "c",
        Pose.of([0, 0, 0], [3.0, 0, 4.0]) @ rig.relative_pose("c", "b"),
        0.1,
        ("00",),
        100,
        COVARIANCE,
    )
    (error,) = associate_cameras("a", [pair(rig, "a", "b"), pair(rig, "a", "c"), moved]).path_errors
    assert (error.rotation_deg, error.translation_mm) == (pytest.approx(0, abs=1e-6), pytest.approx(5.0))


def test_loop_errors_are_for_every_triangle_and_no_choice_of_core_changes_them(rig):
    off = Pair(
        "b",
        "c",
        rig.relative_pose("c", "b") @ exp(np.array([0, 0, 0, 0, 0, 3.0])),
        0.1,
        ("00",),
        100,
        COVARIANCE,
    )
    pairs = [pair(rig, *names) for names in combinations("abcd", 2) if names != ("b", "c")]
    for core in "abcd":
        loops = {e.cameras: e for e in associate_cameras(core, [*pairs, off]).loop_errors}
        assert sorted("".join(sorted(cameras)) for cameras in loops) == ["abc", "abd", "acd", "bcd"]
        for cameras, loop in loops.items():
            concerned = {"b", "c"} <= set(cameras)
            assert loop.translation_mm == pytest.approx(3.0 if concerned else 0.0, abs=1e-9)
            assert loop.rotation_deg == pytest.approx(0.0, abs=1e-6)
            assert (loop.p_value < 1e-9) == concerned
            assert loop.dof == 6


def test_a_triangle_with_a_missing_side_makes_no_loop(rig):
    assert (
        associate_cameras(
            "a", [pair(rig, *names) for names in (("a", "b"), ("b", "c"), ("c", "d"))]
        ).loop_errors
        == ()
    )


def test_errors_that_pairs_share_do_not_open_loops(rig, board, poses):
    """Estimated intrinsics affect all pairs alike; independent covariances would predict larger misclosures."""
    board_mm = corner_points_mm(board)
    joint, alone = [], []
    for seed in range(count_examples(20)):
        own = make_detections(rig, board, poses, noise_px=0.1, seed=seed)
        cameras = {name: calibrate_camera(name, own, board_mm) for name in "abc"}
        pairs = calibrate_pairs(own, cameras, board_mm, Silent())
        joint += [e.chi2_per_dof for e in associate_cameras("b", pairs).loop_errors]
        alone += [
            e.chi2_per_dof
            for e in associate_cameras("b", [replace(p, sensitivity={}) for p in pairs]).loop_errors
        ]
    assert np.mean(joint) == pytest.approx(1.0, abs=0.3)
    assert np.mean(alone) < 0.1


def test_groups_are_connected_components_largest_first(rig):
    assert find_groups("abcd", [pair(rig, "b", "c"), pair(rig, "c", "d")]) == [("b", "c", "d"), ("a",)]
    assert find_groups("abcd", []) == [("a",), ("b",), ("c",), ("d",)]


def test_the_core_is_the_most_central_camera(rig):
    assert (
        select_core(make_empty_detections(rig), [pair(rig, *names) for names in combinations("abcd", 2)])
        in "bc"
    )
    assert (
        select_core(make_empty_detections(rig), [pair(rig, *names) for names in combinations("abc", 2)])
        == "b"
    )
    assert (
        select_core(make_empty_detections(rig), [pair(rig, *names) for names in combinations("bcd", 2)])
        == "c"
    )


def test_a_central_camera_that_shares_little_is_not_the_core(rig):
    pairs = [pair(rig, *n, corners=20 if "b" in n or "c" in n else 100) for n in combinations(rig.cameras, 2)]
    assert select_core(make_empty_detections(rig), pairs) in ("a", "d")
