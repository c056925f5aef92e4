"""Camera checks of a sequence: when a fault is noticed, what its findings say, and which rig is proposed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError, ReconstructionError
from beltscape.core.progress import Silent
from beltscape.files.rig_json import read_rig, write_rig
from beltscape.pipeline.measuring.flow_chain import require_same_rig
from beltscape.pipeline.reconstructing.camera_checks import CheckSchedule, make_rig_writer
from beltscape.pipeline.reconstructing.checked_matcher import CheckedMatcher
from beltscape.stereo.consistency.pose_change import apply_pose_change
from tests.synthetic.demo import crop_demo_rig, read_cropped_frame, read_cropped_truth
from tests.thorough import THOROUGH, list_cases

TRUTH = read_cropped_truth("belt_loaded")
RIG = crop_demo_rig()
EVERY = 3


def make_depth(values, sigma_mm=0.05):
    found = np.isfinite(values)
    sigma = np.where(found, sigma_mm, np.nan).astype(np.float32)
    return DepthMap(values, sigma, np.where(found, 4, 0).astype(np.uint8), found.astype(np.float32))


class TrueDepthMatcher:
    """A matcher that returns the true depth; without a surface where the core's image is dark."""

    def reconstruct(self, frame_set, reporter):
        if frame_set.images[RIG.core].mean() < 2:
            raise ReconstructionError(f"frame {frame_set.frame}: no surface found")
        return make_depth(TRUTH)


def make_matcher(rig=RIG, propose=None):
    return CheckedMatcher(
        rig, rig.auxiliaries, (570.0, 750.0), lambda _: TrueDepthMatcher(), every=EVERY, propose_rig=propose
    )


@pytest.fixture(scope="module")
def frame():
    return read_cropped_frame("belt_loaded")


def with_images(frame, change):
    return replace(frame, images={name: change(name, image) for name, image in frame.images.items()})


def faults_of(matcher):
    return [(f.check, f.subject, f.effect) for f in matcher.findings if f.is_fault]


def test_sound_frames_have_findings_without_fault(frame):
    matcher = make_matcher()
    for _ in range(2 * EVERY):
        matcher.reconstruct(frame, Silent())
        assert not faults_of(matcher)
    assert [f.value for f in matcher.findings if f.check == "camera_redundancy"] == [4]


def test_camera_that_moves_is_excluded_and_its_pose_proposed(frame, tmp_path):
    truth = np.concatenate([np.deg2rad([0.0, 0.06, 0.0]), [0.0, 0.0, 0.0]])
    old_rig = apply_pose_change(RIG, "cam2", -truth)
    matcher = make_matcher(old_rig, make_rig_writer(tmp_path, old_rig, Silent()))
    matcher.reconstruct(frame, Silent())
    assert matcher.excluded == ("cam2",)
    expected = [("camera_pose", "cam2", "degraded"), ("camera_redundancy", "", "degraded")]
    assert faults_of(matcher) == expected
    pose = next(f for f in matcher.findings if f.is_fault)
    assert pose.systematic_mm > 0
    matcher.reconstruct(frame, Silent())  # not checked: the fault holds, its past error does not
    assert faults_of(matcher) == expected
    assert next(f for f in matcher.findings if f.is_fault).systematic_mm == 0
    proposed = read_rig(tmp_path / "rig.proposed.json")
    change = proposed.cam_from_core["cam2"] @ RIG.cam_from_core["cam2"].inverse()
    assert np.rad2deg(np.abs(change.rotation - np.eye(3)).max()) < 0.01
    assert "cam2.turn_y_rad" in proposed.covariance["parameters"]
    assert matcher.rig is old_rig


def test_moved_core_degrades_or_voids_the_frame(frame):
    for pixels, effect in ((4, "missing"), *([(1, "degraded")] if THOROUGH else [])):
        matcher = make_matcher()
        moved = with_images(
            frame, lambda name, image, px=pixels: np.roll(image, px, axis=0) if name == RIG.core else image
        )
        try:
            matcher.reconstruct(moved, Silent())
        except ReconstructionError as error:
            assert "core camera cam0 moved" in str(error)
        assert ("camera_pose", RIG.core, effect) in faults_of(matcher)


@pytest.mark.thorough
@pytest.mark.parametrize("step", list_cases([(1, -1), (-1, 1), (-1, -1)], [(-1, -1)]))
def test_mirrored_images_of_all_cameras_are_named(frame, step):
    matcher = make_matcher()
    mirrored = with_images(frame, lambda _, image: np.ascontiguousarray(image[:: step[0], :: step[1]]))
    with pytest.raises(ReconstructionError, match="flipped back they fit the rig"):
        matcher.reconstruct(mirrored, Silent())
    assert {effect for _, _, effect in faults_of(matcher)} == {"missing"}


@pytest.mark.thorough
def test_mirrored_auxiliary_is_named(frame):
    matcher = make_matcher()
    mirrored = with_images(
        frame, lambda name, image: np.ascontiguousarray(image[:, ::-1]) if name == "cam3" else image
    )
    matcher.reconstruct(mirrored, Silent())
    assert any("mirrored images (cam3)" in f.text and "(left to right)" in f.text for f in matcher.findings)
    assert matcher.excluded == ("cam3",)


def test_frames_are_not_valid_before_the_cameras_were_checked(frame):
    matcher = make_matcher()
    plain = with_images(frame, lambda _, image: np.full_like(image, 90))
    matcher.reconstruct(plain, Silent())
    assert ("camera_pose_unchecked", "", "degraded") in faults_of(matcher)
    for _ in range(EVERY):
        matcher.reconstruct(frame, Silent())
    assert not faults_of(matcher)


def test_unusual_frames_and_long_pauses_are_checked_at_once(frame):
    schedule = CheckSchedule(100)
    usual = make_depth(TRUTH)
    assert schedule.is_due(frame, usual)
    schedule.note_check(replace(frame, time_ns=0), usual, has_passed=True)
    assert not schedule.is_due(replace(frame, time_ns=10**9), usual)
    assert schedule.is_due(replace(frame, time_ns=2 * 10**9), make_depth(TRUTH, 0.1))
    holes = TRUTH.copy()
    holes[:, : TRUTH.shape[1] // 4] = np.nan
    assert schedule.is_due(replace(frame, time_ns=2 * 10**9), make_depth(holes))
    assert schedule.is_due(replace(frame, time_ns=11 * 10**9), usual)


def test_empty_belt_of_another_rig_is_refused(tmp_path):
    write_rig(tmp_path / "rig.json", RIG)
    require_same_rig(tmp_path / "000", RIG, 670.0, Silent())
    other = apply_pose_change(RIG, "cam2", np.array([0.004, 0, 0, 0, 0, 0]))
    with pytest.raises(InputError, match="reconstructed with another rig"):
        require_same_rig(tmp_path, other, 670.0, Silent())
