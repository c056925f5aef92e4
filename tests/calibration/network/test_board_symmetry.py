"""Symmetric chessboards, numbered from either end by different cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.calibration.intrinsics.zhang import calibrate_camera
from beltscape.calibration.network.board_symmetry import (
    list_quarter_turns,
    make_board_turn,
    turn_corners,
    unify_numbering,
)
from beltscape.calibration.network.synchronisation import find_frame_misfits
from beltscape.core.geometry.pose import Pose
from beltscape.core.progress import Silent
from beltscape.target.board import CharucoBoard, Chessboard, corner_points_mm
from tests.synthetic.boards import board_poses, row_of_cameras
from tests.synthetic.detections import make_detections, project_corners
from tests.thorough import THOROUGH, examples, list_cases

ODD = Chessboard(corners=(7, 5), square_mm=40)
EVEN = Chessboard(corners=(8, 6), square_mm=35)
SQUARE = Chessboard(corners=(6, 6), square_mm=40)
NOISE_PX = 0.1
RIG = row_of_cameras(["a", "b", "c", "d"])


def make_monocular(own, board, rig=RIG):
    """Return every camera's monocular calibration with its true lens."""
    points = corner_points_mm(board)
    return {
        name: calibrate_camera(name, own, points, known=rig.cameras[name], min_views=1)
        for name in own.cameras
    }


def renumber(own, board, share, rng):
    """Return detections with a share of the views, by camera or in all, numbered from another end."""
    turns = list_quarter_turns(board)[1:]

    def maybe(name, corners):
        often = share[name] if isinstance(share, dict) else share
        turn = int(rng.choice(turns))
        return turn_corners(corners, board, turn) if rng.random() < often else corners

    views = {name: {f: maybe(name, c) for f, c in found.items()} for name, found in own.views.items()}
    return BoardDetections(own.sizes_px, views, own.images)


def list_inconsistent_frames(found, true, board, cameras=None):
    """Return the frames in which the cameras do not number the board from the same end."""
    bad = []
    for frame in true.frames:
        seeing = [name for name in cameras or true.cameras if frame in true.views[name]]
        ends = {_end(found.views[name][frame], true.views[name][frame], board) for name in seeing}
        if len(ends) > 1:
            bad.append(frame)
    return bad


def _end(found, true, board):
    """Quarter turns by which corners were renumbered."""
    pixels = {turn: turn_corners(true, board, turn).pixels for turn in list_quarter_turns(board)}
    return next(turn for turn in pixels if np.array_equal(pixels[turn], found.pixels))


def delay_camera(own, camera, by):
    """Return detections with one camera's frames named ``by`` too high, without those past the end."""
    there = set(own.frames)
    views = {f"{int(f) + by:02d}": c for f, c in own.views[camera].items()}
    kept = {f: views[f] for f in sorted(views) if f in there}
    return BoardDetections(own.sizes_px, {**own.views, camera: kept}, own.images)


@pytest.mark.parametrize("board", [ODD, EVEN, SQUARE], ids=["odd", "even", "square"])
@pytest.mark.parametrize("share", list_cases([0.1, 0.3, 0.5], {0.5}))
@pytest.mark.parametrize("frames", list_cases([4, 9], {4}))
def test_every_camera_numbers_the_board_from_the_same_end_afterwards(board, share, frames):
    for seed in range(2):
        true = make_detections(RIG, board, board_poses(board, frames, seed=seed), NOISE_PX, seed)
        found = renumber(true, board, share, np.random.default_rng(seed))
        numbering = unify_numbering(found, make_monocular(found, board), board)
        assert list_inconsistent_frames(numbering.detections, true, board) == []
        assert numbering.ambiguous == ()
        again = unify_numbering(numbering.detections, numbering.monocular, board)
        assert (again.detections, again.renumbered) == (numbering.detections, ())


def test_unify_numbering_does_not_need_known_lenses():
    true = make_detections(RIG, ODD, board_poses(ODD, 8), 0.3)
    found = renumber(true, ODD, 0.5, np.random.default_rng(5))
    own = {name: calibrate_camera(name, found, corner_points_mm(ODD)) for name in found.cameras}
    assert list_inconsistent_frames(unify_numbering(found, own, ODD).detections, true, ODD) == []


def test_of_cameras_mounted_upside_down_the_fewer_are_turned():
    true = make_detections(RIG, ODD, board_poses(ODD, 6), NOISE_PX)
    found = renumber(true, ODD, {"a": 0, "b": 0, "c": 1, "d": 0}, np.random.default_rng(1))
    numbering = unify_numbering(found, make_monocular(found, ODD), ODD)
    assert numbering.renumbered == tuple(("c", frame) for frame in found.views["c"])
    two = found.restrict(("a", "c"), found.frames)
    assert {camera for camera, _ in unify_numbering(two, make_monocular(two, ODD), ODD).renumbered} == {"c"}


def test_the_rig_is_the_same_as_if_all_had_been_numbered_alike():
    true = make_detections(RIG, ODD, board_poses(ODD, 8), NOISE_PX)
    found = renumber(true, ODD, 0.4, np.random.default_rng(2))
    mended = unify_numbering(found, make_monocular(found, ODD), ODD).detections
    wanted, rig = (solve_hierarchy(own, ODD, "a", Silent()).rig for own in (true, mended))
    for name in RIG.cameras:
        offset = wanted.cam_from_core[name].inverse() @ rig.cam_from_core[name]
        assert np.linalg.norm(offset.translation_mm) < 1e-3


def test_the_poses_are_turned_with_the_corners():
    true = make_detections(RIG, SQUARE, board_poses(SQUARE, 6), 0.0)
    found = renumber(true, SQUARE, 0.5, np.random.default_rng(3))
    numbering = unify_numbering(found, make_monocular(found, SQUARE), SQUARE)
    assert numbering.renumbered
    for name, frame in numbering.renumbered:
        corners, own = numbering.detections.views[name][frame], numbering.monocular[name]
        predicted = own.camera.project(own.cam_from_board[frame].apply(corner_points_mm(SQUARE)[corners.ids]))
        np.testing.assert_allclose(predicted, corners.pixels, atol=1e-3)


def test_cameras_that_share_few_frames_are_linked_through_others():
    shared = {"a": range(4), "b": range(2, 6), "c": range(4, 8), "d": range(6, 10)}
    for seed in range(3):
        true = make_detections(RIG, ODD, board_poses(ODD, 10, seed=seed), NOISE_PX, seed, seen_by=shared)
        found = renumber(true, ODD, 0.5, np.random.default_rng(seed))
        numbering = unify_numbering(found, make_monocular(found, ODD), ODD)
        assert list_inconsistent_frames(numbering.detections, true, ODD) == []
        assert numbering.ambiguous == ()


def test_a_rejected_view_is_renumbered_too():
    true = make_detections(RIG, ODD, board_poses(ODD, 6), NOISE_PX)
    found = renumber(true, ODD, {"a": 0, "b": 1, "c": 0, "d": 0}, np.random.default_rng(1))
    own = make_monocular(found, ODD)
    left = {frame: pose for frame, pose in own["b"].cam_from_board.items() if frame != "03"}
    own["b"] = replace(own["b"], cam_from_board=left, rejected={"03": "for a test"})
    numbering = unify_numbering(found, own, ODD)
    assert ("b", "03") in numbering.renumbered
    assert list_inconsistent_frames(numbering.detections, true, ODD) == []


def test_some_images_of_other_instants_do_not_mislead():
    for seed in range(4):
        rng = np.random.default_rng(seed)
        true = make_detections(RIG, ODD, board_poses(ODD, 12, seed=seed), NOISE_PX, seed)
        found = renumber(true, ODD, 0.5, rng)
        right = {name: dict(views) for name, views in true.views.items()}
        wrong = {name: dict(views) for name, views in found.views.items()}
        for name in RIG.cameras:
            taken, other = rng.choice(sorted(right[name]), 2, replace=False)
            wrong[name][taken] = found.views[name][other]
            del right[name][taken]
        misplaced = BoardDetections(found.sizes_px, wrong, found.images)
        numbering = unify_numbering(misplaced, make_monocular(misplaced, ODD), ODD)
        assert (
            list_inconsistent_frames(
                numbering.detections, BoardDetections(true.sizes_px, right, true.images), ODD
            )
            == []
        )


@pytest.mark.parametrize("frames", list_cases([1, 2, 6], {1, 2}))
def test_a_board_at_rest_is_reported_as_ambiguous(frames):
    rig = row_of_cameras(["a", "b"])
    true = make_detections(rig, ODD, board_poses(ODD, 1) * frames, NOISE_PX)
    numbering = unify_numbering(true, make_monocular(true, ODD, rig), ODD)
    assert numbering.detections is true  # of equally good numberings the one that was found
    views = "1 common view" if frames == 1 else f"{frames} common views"
    assert numbering.ambiguous == (
        f"cameras a and b: the chessboard 7×5 inner corners, square 40 mm, may be numbered from more than one end, "
        f"and their {views} do not tell which; move and tilt the board between views, or use a board with one "
        "even and one odd side",
    )


@pytest.mark.parametrize("wobble_mm", list_cases([0.0, 0.1, 0.3, 1.0, 3.0], {0.0, 3.0}))
def test_a_board_that_hardly_moves_is_unified_or_reported_as_ambiguous(wobble_mm):
    rig, middle = row_of_cameras(["a", "b"]), np.array([160.0, 120.0, 0.0])
    for seed in range(4):
        rng = np.random.default_rng(seed)
        poses = []
        for _ in range(3):
            tilt = Pose.of(
                np.array([0.2, -0.3, 0.1]) + rng.normal(0, wobble_mm / 300, 3), np.zeros(3)
            ).rotation
            poses.append(Pose(tilt, rng.normal([0, 0, 700.0], wobble_mm) - tilt @ middle))
        true = make_detections(rig, ODD, poses, NOISE_PX, seed)
        found = renumber(true, ODD, 0.5, rng)
        numbering = unify_numbering(found, make_monocular(found, ODD, rig), ODD)
        assert numbering.ambiguous or not list_inconsistent_frames(numbering.detections, true, ODD)
        assert wobble_mm < 3.0 or not numbering.ambiguous


def test_boards_that_need_no_renumbering_are_returned_unchanged(rig, board, poses):
    top = Chessboard(corners=(7, 6), square_mm=40)
    for kind in (board, top, ODD):
        own = make_detections(rig, kind, board_poses(kind, 5), NOISE_PX)
        alone = make_monocular(own, kind)
        numbering = unify_numbering(own, alone, kind)
        assert numbering.detections is own
        assert numbering.monocular is alone
        assert numbering.renumbered == numbering.ambiguous == ()


def test_cameras_without_a_common_frame_are_unchanged():
    shared = {"a": range(3), "b": range(3, 6), "c": (), "d": ()}
    own = make_detections(RIG, ODD, board_poses(ODD, 6), NOISE_PX, seen_by=shared).restrict(
        ("a", "b"), [f"{i:02d}" for i in range(6)]
    )
    numbering = unify_numbering(own, make_monocular(own, ODD), ODD)
    assert (numbering.detections, numbering.ambiguous) == (own, ())


@pytest.mark.parametrize("by", list_cases([-2, -1, 1, 2], {-1}))
@pytest.mark.parametrize("share", list_cases([0.0, 0.5], {0.5}))
def test_a_shifted_camera_is_reported_after_unification(by, share):
    true = delay_camera(make_detections(RIG, ODD, board_poses(ODD, 9), NOISE_PX), "c", by)
    found = renumber(true, ODD, share, np.random.default_rng(by + 5))
    numbering = unify_numbering(found, make_monocular(found, ODD), ODD)
    assert [(m.camera, m.shift) for m in find_frame_misfits(numbering.monocular, sorted(found.frames))] == [
        ("c", by)
    ]
    assert list_inconsistent_frames(numbering.detections, true, ODD, "abd") == []


@pytest.mark.parametrize("share", list_cases([0.0, 0.5], {0.5}))
def test_a_shuffled_camera_is_reported_after_unification(share):
    for seed in range(3 if THOROUGH else 1):
        rng = np.random.default_rng(seed)
        own = make_detections(RIG, ODD, board_poses(ODD, 9, seed=seed), NOISE_PX, seed)
        names = sorted(own.views["c"])
        mixed = {name: own.views["c"][names[k]] for name, k in zip(names, rng.permutation(9), strict=True)}
        true = BoardDetections(own.sizes_px, {**own.views, "c": mixed}, own.images)
        found = renumber(true, ODD, share, rng)
        numbering = unify_numbering(found, make_monocular(found, ODD), ODD)
        blamed = find_frame_misfits(numbering.monocular, sorted(found.frames))
        assert [(m.camera, m.shift) for m in blamed] == [("c", None)]
        assert list_inconsistent_frames(numbering.detections, true, ODD, "abd") == []


def test_a_charuco_board_has_no_turns():
    assert list_quarter_turns(
        CharucoBoard(squares=(8, 6), square_mm=40, marker_mm=29, dictionary="DICT_4X4_50")
    ) == (0,)
    assert list_quarter_turns(ODD) == list_quarter_turns(EVEN) == (0, 2)
    assert list_quarter_turns(SQUARE) == (0, 1, 2, 3)


@examples(30)
@given(board=st.sampled_from([ODD, EVEN, SQUARE]), index=st.integers(0, 3), seed=st.integers(0, 2**32 - 1))
def test_turned_corners_lie_where_the_turned_board_has_them_and_turn_back(board, index, seed):
    rng = np.random.default_rng(seed)
    turn = list_quarter_turns(board)[index % len(list_quarter_turns(board))]
    points = corner_points_mm(board)
    pose = board_poses(board, 1, seed=seed)[0]
    full = project_corners(RIG, "a", pose, points, np.zeros((len(points), 2)))
    some = np.sort(rng.choice(len(full), max(len(full) // 2, 1), replace=False))
    corners = replace(full, ids=full.ids[some], pixels=full.pixels[some])
    turned = turn_corners(corners, board, turn)
    assert (np.diff(turned.ids) > 0).all()
    again = (RIG.cam_from_core["a"] @ pose @ make_board_turn(board, turn)).apply(points[turned.ids])
    np.testing.assert_allclose(RIG.cameras["a"].project(again), turned.pixels, atol=1e-6)
    back = turn_corners(turned, board, -turn % 4)
    np.testing.assert_array_equal(back.ids, corners.ids)
    np.testing.assert_array_equal(back.pixels, corners.pixels)
