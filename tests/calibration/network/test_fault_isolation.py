"""Fault isolation in a camera network: which camera or pair is named, and when none is."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.calibration.intrinsics.zhang import calibrate_camera
from beltscape.calibration.network.association import LoopError, associate_cameras
from beltscape.calibration.network.fault_isolation import NetworkFault, describe_fault, isolate_fault
from beltscape.calibration.network.pairs import Pair, calibrate_pairs
from beltscape.calibration.network.pose_chains import exp
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.target.board import corner_points_mm
from tests.optional import require
from tests.synthetic.boards import board_poses, row_of_cameras
from tests.synthetic.detections import make_detections
from tests.thorough import count_examples, list_cases

SIGMA = np.diag(np.repeat([1e-4, 0.1], 3))
SHIFT = exp(np.array([0.01, 0.0, 0.0, 5.0, 0.0, 0.0]))


def pairs(rig: Rig, wrong=(), seed: int = 0, noise: float = 1.0) -> list[Pair]:
    """All pairs with noise; the ``wrong`` ones also with a gross error of their second camera."""
    rng = np.random.default_rng(seed)
    found = []
    for first, second in combinations(rig.cameras, 2):
        pose = rig.relative_pose(second, first) @ exp(noise * SIGMA @ rng.normal(size=6))
        if (first, second) in wrong:
            pose = SHIFT @ pose
        found.append(Pair(first, second, pose, 0.1, ("00",), 100, SIGMA**2))
    return found


def rig_of(count: int) -> Rig:
    return row_of_cameras(list("abcdef"[:count]))


def loop(names: str, chi2_per_dof: float) -> LoopError:
    return LoopError(tuple(names), 0.1, 1.0, np.zeros(6), np.eye(6), 6 * chi2_per_dof, 6)


@pytest.mark.parametrize("cameras", [2, 3, 4, 5, 6])
@pytest.mark.parametrize("noise", [0.0, 1.0, 4.0])
def test_a_consistent_network_has_no_fault_even_if_all_errors_are_larger_than_stated(cameras, noise):
    for seed in range(count_examples(10)):
        assert describe_fault(associate_cameras("a", pairs(rig_of(cameras), seed=seed, noise=noise))) is None


@pytest.mark.parametrize("cameras", [4, 5, 6])
@pytest.mark.parametrize("noise", [1.0, 4.0])
def test_a_camera_that_is_displaced_in_half_of_its_pairs_is_isolated(cameras, noise):
    wrong = [("a", "d"), ("b", "d")]
    for seed in range(count_examples(10)):
        network = associate_cameras("b", pairs(rig_of(cameras), wrong, seed, noise))
        assert require(isolate_fault(network.loop_errors)).cameras == (("d",) if cameras > 4 else ("c", "d"))


def test_with_four_cameras_one_that_fits_only_one_other_is_reported_as_a_pair():
    """Half of three pairs: d fits c alone, which is the same as if the pair c-d were wrong."""
    network = associate_cameras("b", pairs(rig_of(4), [("a", "d"), ("b", "d")]))
    assert require(describe_fault(network)).startswith("pair c–d disagrees, by up to 0.58° and ")


@pytest.mark.parametrize("cameras", [4, 5, 6])
@pytest.mark.parametrize("bad_pair", [("a", "b"), ("b", "d"), ("c", "d")])
def test_a_bad_pair_is_isolated(cameras, bad_pair):
    for seed in range(count_examples(10)):
        network = associate_cameras("a", pairs(rig_of(cameras), [bad_pair], seed))
        assert require(isolate_fault(network.loop_errors)).cameras == bad_pair
        assert " while its cameras agree with all others: " in require(describe_fault(network))


def test_three_cameras_do_not_isolate_the_fault():
    text = require(describe_fault(associate_cameras("a", pairs(rig_of(3), [("a", "b")]))))
    assert text.startswith("cameras a, b, c contradict each other, by up to 0.55° and ")
    assert text.endswith("one of them moved, or its clock is off")


def test_two_bad_pairs_without_a_common_camera_are_not_isolated():
    network = associate_cameras("a", pairs(rig_of(6), [("a", "b"), ("c", "d")]))
    assert set(require(isolate_fault(network.loop_errors)).cameras) >= set("abcd")


def test_two_bad_cameras_of_five_are_not_isolated():
    wrong = [("a", "d"), ("b", "d"), ("a", "e"), ("c", "e"), ("d", "e")]
    network = associate_cameras("a", pairs(rig_of(5), wrong))
    assert set(require(isolate_fault(network.loop_errors)).cameras) == set("abcde")


def test_a_loop_that_is_slightly_worse_than_the_rest_is_no_fault():
    values = {"abc": 3.0, "abd": 30.0, "acd": 9.0, "bcd": 6.0}
    assert isolate_fault([loop(*item) for item in values.items()]) is None


@pytest.mark.parametrize(
    ("cameras", "text"),
    [
        (("c",), "camera c disagrees in the triangles it is part of, by up to 0.12° and 3.4 mm, "),
        (
            ("a", "b"),
            "pair a–b disagrees, by up to 0.12° and 3.4 mm, while its cameras agree with all others: ",
        ),
        (
            tuple("abc"),
            "cameras a, b, c contradict each other, by up to 0.12° and 3.4 mm, and the loops cannot ",
        ),
    ],
)
def test_the_description_names_cameras_and_size(cameras, text):
    assert NetworkFault(cameras, 20.0, 0.1234, 3.4321).describe().startswith(text)


def displace_camera(rig: Rig, name: str, shift: Pose) -> Rig:
    return Rig(rig.core, rig.cameras, {**rig.cam_from_core, name: shift @ rig.cam_from_core[name]})


@pytest.fixture(scope="module")
def rows(board) -> tuple[Rig, list[Pose]]:
    return row_of_cameras(list("abcde")), board_poses(board, 14)


@pytest.mark.parametrize("noise", list_cases([0.0, 0.02, 0.3], {0.3}))
def test_a_rigid_rig_has_no_fault(rows, board, noise):
    rig, poses = rows
    seen = make_detections(rig, board, poses, noise)
    assert describe_fault(solve_hierarchy(seen, board, "a", Silent()).network) is None


def test_a_camera_that_was_displaced_during_the_capture_is_isolated(rows, board):
    """d is turned by 0.1° before the eighth frame, and e sees the board only afterwards."""
    rig, poses = rows
    frames = {n: range(14) for n in "abcd"} | {"e": range(7, 14)}
    before = make_detections(rig, board, poses, 0.05, seen_by=frames)
    after = make_detections(
        displace_camera(rig, "d", Pose.of([0, np.deg2rad(0.1), 0], [0, 0, 0])), board, poses, 0.05
    )
    views = {**before.views, "d": {**before.views["d"]}}
    views["d"] |= {f"{i:02d}": after.views["d"][f"{i:02d}"] for i in range(7, 14)}  # pyrefly: ignore[unsupported-operation]
    network = solve_hierarchy(
        BoardDetections(before.sizes_px, views, before.images), board, "a", Silent()
    ).network
    assert require(isolate_fault(network.loop_errors)).cameras == ("d",)


def test_a_camera_whose_frames_are_late_by_one_is_isolated(rows, board):
    rig, poses = rows
    own = make_detections(rig, board, poses, 0.05)
    late = {f"{i:02d}": own.views["c"][f"{i + 1:02d}"] for i in range(13)}
    shifted = BoardDetections(own.sizes_px, {**own.views, "c": late}, own.images)
    board_mm = corner_points_mm(board)
    cameras = {name: calibrate_camera(name, shifted, board_mm) for name in rig.cameras}
    network = associate_cameras("a", calibrate_pairs(shifted, cameras, board_mm, Silent()))
    assert require(describe_fault(network)).startswith("camera c disagrees in the triangles it is part of, ")
