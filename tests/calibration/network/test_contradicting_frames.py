"""Frames that contradict the others: named and left out with their cause, where each camera by itself fits them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.calibration.assessment.findings import list_calibration_findings
from beltscape.calibration.assessment.fit_quality import compute_camera_fits
from beltscape.calibration.assessment.score import compute_rig_errors, summarise_errors
from beltscape.calibration.bundle_adjustment import adjust_bundle
from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.calibration.lens_review import select_suspicious_pairs
from beltscape.calibration.network.contradicting_frames import describe_contradicting_frames
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.kernels import load
from beltscape.pipeline.calibrating.intrinsics import KnownIntrinsics
from beltscape.pipeline.calibrating.solving import solve_rig
from beltscape.target.board import corner_points_mm, list_triples
from tests.synthetic.camera_arrays import (
    BOARD,
    boards_before,
    boards_close,
    detect,
    like_cameras,
    widen,
)
from tests.thorough import list_cases, list_rows

LATE = {"01", "04", "07", "10", "13", "16", "19", "22"}


def see_late(
    count: int, seed: int, bend_mm: float, moved_mm: float, model: str = "brown"
) -> tuple[Rig, BoardDetections]:
    """Return an array whose second camera takes eight of 24 frames when the board has moved on."""
    rig, rng = like_cameras(count, seed), np.random.default_rng(seed)
    if model != "brown":
        rig = widen(rig, model, seed)
    poses = boards_before(rig, 24, 0.4, seed) if model == "brown" else boards_close(24, seed)
    seen = detect(rig, poses, 0.04, seed, bend_mm)
    later = [Pose(pose.rotation, pose.translation_mm + moved_mm * rng.choice([-1, 1], 3)) for pose in poses]
    after = detect(rig, later, 0.04, seed, bend_mm)
    own = {frame: (after if frame in LATE else seen).views["c01"][frame] for frame in seen.views["c01"]}
    views = {
        name: {frame: corners for frame, corners in each.items() if len(corners) >= LEAST}
        for name, each in {**seen.views, "c01": own}.items()
    }
    return rig, replace(seen, views=views)


def test_frames_of_a_pair_that_would_be_reported_are_looked_into():
    rig = like_cameras(2, 3)
    seen = detect(rig, boards_before(rig, 12, 0.4, 3), 0.04, 3, 0.0)
    hierarchy = solve_hierarchy(seen, BOARD, None, Silent(), lens_models=dict.fromkeys(seen.cameras, "brown"))
    adjustment = adjust_bundle(hierarchy, BOARD)
    assert select_suspicious_pairs(hierarchy, adjustment) == []
    worse = replace(hierarchy.network.pairs[0], rms_px=0.7)
    network = replace(hierarchy.network, pairs=(worse,))
    assert select_suspicious_pairs(replace(hierarchy, network=network), adjustment) == [worse]


LEAST = 20
"""Corners in a view; close boards reach beyond the images."""
CASES = [
    (2, 0.0, 0.6, "brown"), (2, 0.7, 0.6, "brown"), (2, 0.7, 5.0, "brown"), (3, 0.7, 1.0, "brown"),
    (2, 0.7, 0.4, "fisheye"), (2, 0.0, 0.6, "fisheye"), (2, 0.3, 2.0, "fisheye"), (3, 0.7, 1.0, "fisheye"),
    (2, 0.7, 1.0, "rational"),
]  # fmt: skip
"""With 0.4 mm the joint adjustment rejects the views as outliers and nothing else shows that they are late."""


@pytest.mark.parametrize(
    ("count", "bend_mm", "moved_mm", "model"),
    list_rows(CASES, {(2, 0.7, 0.6, "brown")}),
)
def test_frames_without_a_common_instant_are_named_and_left_out(count, bend_mm, moved_mm, model):
    rig, seen = see_late(count, 3, bend_mm, moved_mm, model)
    asked = "brown" if model == "brown" else "auto"
    solved = solve_rig(seen, BOARD, "c00", Silent(), KnownIntrinsics({}), asked)
    hierarchy, adjustment = solved.hierarchy, solved.adjustment
    assert {camera.model for camera in adjustment.rig.cameras.values()} == {model}
    named = {each.frame for each in hierarchy.contradicting_frames}
    assert named <= LATE
    assert len(named) >= 7
    errors = compute_rig_errors(
        adjustment.rig, hierarchy.detections, BOARD, load(), corners_mm=adjustment.geometry.points_mm
    )
    training = summarise_errors(errors)
    assert training.rms_px < 0.3
    fits = compute_camera_fits(errors, list_triples(BOARD))
    first, *_ = list_calibration_findings(hierarchy, fits, None, training)
    assert "have no common instant" in first
    assert all(frame in first for frame in named)
    out = {name for each in hierarchy.contradicting_frames for name in each.cameras}
    assert out == ({"c00", "c01"} if count == 2 else {"c01"})
    for name, pose in adjustment.rig.cam_from_core.items():
        assert np.linalg.norm(pose.center_mm - (rig.cam_from_core[name]).center_mm) < 0.3


@pytest.mark.parametrize("model", list_cases(["brown", "fisheye", "rational"], {"fisheye"}))
def test_synchronous_cameras_lose_no_frame(model):
    rig = like_cameras(2, 4)
    if model != "brown":
        rig = widen(rig, model, 4)
    poses = boards_before(rig, 9, 0.3, 4) if model == "brown" else boards_close(14, 4)
    seen = detect(rig, poses, 0.05, 4, bend_mm=0.5)
    solved = solve_rig(seen, BOARD, None, Silent(), KnownIntrinsics({}), model)
    assert solved.hierarchy.contradicting_frames == ()


NEAR = {"02", "05", "07", "10", "13", "16", "19", "22"}
"""Frames of boards at half the distance."""


def see_otherwise(
    rig: Rig, other: Rig, frames: set[str], seed: int, moved_mm: float = 0.0
) -> BoardDetections:
    """Return what an array sees of 24 boards, and of some ``frames`` another array, late by a motion."""
    rng, middle = np.random.default_rng(seed), corner_points_mm(BOARD).mean(axis=0)
    poses = boards_before(rig, 24, 0.4, seed)
    for number in map(int, NEAR):
        at = poses[number].apply(middle[None])[0] / 2 + rng.uniform(-40, 40, 3)
        poses[number] = Pose(poses[number].rotation, at - poses[number].rotation @ middle)
    seen = detect(rig, poses, 0.04, seed, 0.3)
    later = [Pose(pose.rotation, pose.translation_mm + moved_mm * rng.normal(0, 1, 3)) for pose in poses]
    after = detect(other, later, 0.04, seed + 1, 0.3)
    views = {
        name: {
            frame: corners
            for frame in own
            if len(corners := (after if frame in frames and name == "c01" else seen).views[name][frame])
            >= LEAST
        }
        for name, own in seen.views.items()
    }
    return replace(seen, views=views)


def change_camera(rig: Rig, cause: str, seed: int) -> Rig:
    """Return the array with another second camera: moved, or with another lens."""
    rng, camera, pose = np.random.default_rng(seed), rig.cameras["c01"], rig.cam_from_core["c01"]
    if cause == "moved":
        moved = Pose.of(rng.normal(0, 0.002, 3), rng.normal(0, 0.5, 3)) @ pose
        return replace(rig, cam_from_core={**rig.cam_from_core, "c01": moved})
    if cause == "focus":
        camera = replace(camera, focal_px=camera.focal_px * 1.01)
    if cause == "shifted lens":
        camera = replace(camera, center_px=camera.center_px + rng.normal(0, 3.0, 2))
    return replace(rig, cameras={**rig.cameras, "c01": camera})


LAST, FIRST = {f"{i:02d}" for i in range(18, 24)}, {f"{i:02d}" for i in range(5)}
CAUSES = [
    ("moved", LAST, 0.0, "a camera was moved or its focus touched after frame 17"),
    ("moved", FIRST, 0.0, "a camera was moved or its focus touched before frame 05"),
    ("moved", LATE, 0.0, "a camera is loose or its focus was touched"),
    ("focus", NEAR, 0.0, "the lenses that fit those do not hold at that distance"),
    ("shifted lens", NEAR, 0.0, "the lenses that fit those do not hold at that distance"),
    ("late", NEAR, 1.5, "have no common instant"),
    ("late", LAST, 1.5, "have no common instant"),
    ("late", {"07", "12", "21"}, 1.5, "have no common instant"),
]  # fmt: skip


@pytest.mark.parametrize("seed", list_cases(range(1, 6), {1}))
@pytest.mark.parametrize(("cause", "frames", "moved_mm", "words"), CAUSES)
def test_moved_cameras_and_lenses_of_a_distance_are_distinguished_from_late_frames(
    seed, cause, frames, moved_mm, words
):
    rig = like_cameras(2, seed)
    seen = see_otherwise(rig, change_camera(rig, cause, seed), frames, seed, moved_mm)
    solved = solve_rig(seen, BOARD, "c00", Silent(), KnownIntrinsics({}), "brown")
    contradicting = solved.hierarchy.contradicting_frames
    assert {each.frame for each in contradicting} == frames
    (line,) = describe_contradicting_frames(contradicting)
    assert words in line
    assert ("no common instant" in line) == (cause == "late")
