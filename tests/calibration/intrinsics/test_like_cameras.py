"""Weak monocular starts: like cameras share their lens, and what a bad start makes disagree is no fault."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.calibration import hierarchy as hierarchy_module
from beltscape.calibration.assessment.diagnosis import retest_network
from beltscape.calibration.assessment.findings import list_network_findings
from beltscape.calibration.bundle_adjustment import adjust_bundle
from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.calibration.intrinsics.like_cameras import is_determined, restart_weak_cameras
from beltscape.calibration.intrinsics.zhang import calibrate_camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.files.camera_types import CameraType
from beltscape.target.board import corner_points_mm
from tests.synthetic.camera_arrays import BOARD, boards_before, detect, like_cameras
from tests.thorough import list_cases

BOARD_MM = corner_points_mm(BOARD)
WEAK = "c02"


def detect_one_weak(seed: int) -> tuple[Rig, BoardDetections]:
    """Return an array of which one camera sees three boards square to it only, the others six tilted ones too."""
    rig = like_cameras(5, seed, convergence=0.3)
    boards = [*boards_before(rig, 3, 0.03, seed), *boards_before(rig, 6, 0.3, seed + 50)]
    seen = detect(rig, boards, 0.05, seed, bend_mm=0.1)
    few = dict(list(seen.views[WEAK].items())[:3])
    return rig, replace(seen, views={**seen.views, WEAK: few})


def skip_restarts(detections, monocular, board_mm, known=()):
    return dict(monocular), ()


@pytest.mark.parametrize("seed", list_cases([9, 11], {9}))
def test_a_camera_with_few_square_views_starts_from_the_lens_of_the_like_ones(seed):
    rig, seen = detect_one_weak(seed)
    own = {name: calibrate_camera(name, seen, BOARD_MM) for name in rig.cameras}
    assert [name for name in own if not is_determined(seen, own[name])] == [WEAK]
    again, restarts = restart_weak_cameras(seen, own, BOARD_MM)
    true = rig.cameras[WEAK].focal_px
    assert abs(own[WEAK].camera.focal_px - true).max() > 0.04 * true.max()
    assert abs(again[WEAK].camera.focal_px - true).max() < 0.01 * true.max()
    assert [restart.camera for restart in restarts] == [WEAK]
    assert all(again[name] is own[name] for name in own if name != WEAK)


def test_a_stated_model_finds_the_like_camera_among_others():
    """Three cameras of five have another lens; the weak one has that of the only other one of its model."""
    rig = like_cameras(5, 9, convergence=0.3)
    others = ("c01", "c03", "c04")
    lenses = {
        name: replace(camera, focal_px=1.4 * camera.focal_px) if name in others else camera
        for name, camera in rig.cameras.items()
    }
    boards = [*boards_before(rig, 3, 0.03, 9), *boards_before(rig, 6, 0.3, 59)]
    seen = detect(replace(rig, cameras=lenses), boards, 0.05, 9, bend_mm=0.1)
    few = dict(list(seen.views[WEAK].items())[:3])
    seen = replace(seen, views={**seen.views, WEAK: few})
    own = {name: calibrate_camera(name, seen, BOARD_MM) for name in rig.cameras}
    true = rig.cameras[WEAK].focal_px
    untold, _ = restart_weak_cameras(seen, own, BOARD_MM)
    assert abs(untold[WEAK].camera.focal_px - true).max() > 0.04 * true.max()
    types = {name: CameraType("zoomed" if name in others else "plain") for name in rig.cameras}
    stated, restarts = restart_weak_cameras(replace(seen, types=types), own, BOARD_MM)
    assert abs(stated[WEAK].camera.focal_px - true).max() < 0.015 * true.max()
    assert [restart.camera for restart in restarts] == [WEAK]


def test_like_cameras_that_are_all_weak_agree_after_the_restart():
    """Three boards nearly square to six cameras: alone they spread by 19 %, with a common lens by 2 %."""
    rig = like_cameras(6, 11, convergence=0.3)
    seen = detect(rig, boards_before(rig, 3, 0.02, 11), 0.05, 11, bend_mm=0.3)
    own = {name: calibrate_camera(name, seen, BOARD_MM) for name in rig.cameras}
    again, restarts = restart_weak_cameras(seen, own, BOARD_MM)
    assert len(restarts) == 6
    before, after = (
        np.array([each.camera.focal_px.mean() for each in group.values()]) for group in (own, again)
    )
    assert np.ptp(before) > 0.08 * before.mean()
    assert np.ptp(after) < 0.04 * after.mean()


def test_a_camera_with_another_lens_keeps_it():
    """It has enough tilted views, and the others' lens does not explain them."""
    rig = like_cameras(4, 3)
    zoomed = replace(rig.cameras["c01"], focal_px=rig.cameras["c01"].focal_px * 1.2)
    rig = replace(rig, cameras={**rig.cameras, "c01": zoomed})
    seen = detect(rig, boards_before(rig, 6, 0.3, 3), 0.05, 3)
    own = {name: calibrate_camera(name, seen, BOARD_MM) for name in rig.cameras}
    again, restarts = restart_weak_cameras(seen, own, BOARD_MM)
    assert restarts == ()
    assert again == own


def test_known_intrinsics_are_not_started_again():
    rig, seen = detect_one_weak(11)
    own = {name: calibrate_camera(name, seen, BOARD_MM, known=rig.cameras[name]) for name in rig.cameras}
    assert restart_weak_cameras(seen, own, BOARD_MM, tuple(own)) == (own, ())


def test_what_a_bad_start_makes_disagree_is_a_note_and_no_fault(monkeypatch):
    monkeypatch.setattr(hierarchy_module, "restart_weak_cameras", skip_restarts)
    rig, seen = detect_one_weak(11)
    found = solve_hierarchy(seen, BOARD, None, Silent())
    adjusted = adjust_bundle(found, BOARD)
    assert list_network_findings(found)
    retest = retest_network(found, adjusted)
    assert list_network_findings(retest.hierarchy) == []
    (note,) = retest.notes
    assert note.startswith(f"the monocular start of camera {WEAK} was off (focal length 12")
    assert abs(adjusted.rig.cameras[WEAK].focal_px - rig.cameras[WEAK].focal_px).max() < 2


def test_a_camera_that_moved_is_still_a_fault_after_the_second_test():
    rig = like_cameras(5, 7)
    boards = boards_before(rig, 10, 0.4, 7)
    turned = Pose.of([0, np.radians(0.1), 0], np.zeros(3)) @ rig.cam_from_core[WEAK]
    moved = replace(rig, cam_from_core={**rig.cam_from_core, WEAK: turned})
    before, after = detect(rig, boards, 0.05, 7), detect(moved, boards, 0.05, 7)
    late = {frame: after.views[WEAK][frame] for frame in list(after.views[WEAK])[5:]}
    seen = replace(before, views={**before.views, WEAK: {**before.views[WEAK], **late}})
    found = solve_hierarchy(seen, BOARD, None, Silent())
    retest = retest_network(found, adjust_bundle(found, BOARD))
    assert any(f"camera {WEAK} disagrees" in line for line in list_network_findings(retest.hierarchy))


def test_an_implausible_start_is_replaced_by_the_best_of_several():
    """A camera without a like one: a minimum at an endless focal length is no lens."""
    rig = like_cameras(2, 14, convergence=0.3)
    seen = detect(rig, boards_before(rig, 3, 0.06, 14), 0.05, 14, bend_mm=0.3).restrict(
        ["c01"], ["00", "01", "02"]
    )
    own = calibrate_camera("c01", seen, BOARD_MM)
    endless = replace(own, camera=replace(own.camera, focal_px=own.camera.focal_px * 100), rms_px=0.2)
    again, (restart,) = restart_weak_cameras(seen, {"c01": endless}, BOARD_MM)
    assert restart.own_focal_px > 100_000
    np.testing.assert_allclose(again["c01"].camera.focal_px, rig.cameras["c01"].focal_px, rtol=0.04)
