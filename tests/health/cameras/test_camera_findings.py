"""Findings about the cameras' poses and redundancy: values in mm of depth, faults by camera, none for a sound rig."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.core.findings import worst_effect
from beltscape.health.camera_poses import (
    PoseFault,
    count_unchecked,
    make_pose_findings,
    make_unchecked_finding,
    repeat_faults,
)
from beltscape.health.redundancy import make_redundancy_finding
from beltscape.stereo.consistency.check import (
    POOLED_FRAMES,
    REFERENCE_FRAMES,
    ResidualAccumulator,
    assess_tie_points,
)
from beltscape.stereo.consistency.diagnosis import CameraFault, list_faults
from beltscape.stereo.consistency.pose_change import apply_pose_change
from beltscape.stereo.consistency.tie_points import TiePoints
from beltscape.stereo.consistency.tolerance import compute_tolerance
from tests.stereo.scenes import DEPTH_MM, make_ring
from tests.thorough import THOROUGH

SIZE_PX = (612, 512)
RIG = make_ring(size_px=SIZE_PX)


def make_tie_points(rig, *, noise_px=0.03, bias_px=0.0, seed=1, count=250):
    """Return tie points as the rig would see them, with noise and 5 % of false matches."""
    rng = np.random.default_rng(seed)
    core_px = rng.uniform(30, np.array(SIZE_PX) - 30, (count, 2))
    depth = rng.uniform(0.93, 1.03, count) * DEPTH_MM
    rays = (core_px - rig.core_camera.center_px) / rig.core_camera.focal_px
    points = np.concatenate([rays, np.ones((count, 1))], axis=1) * depth[:, None]
    observed = {}
    for name in rig.auxiliaries:
        seen = rig.cameras[name].project(rig.cam_from_core[name].apply(points))
        seen = seen + rng.normal(0, noise_px, seen.shape) + bias_px
        false = rng.random(count) < 0.05
        seen[false] += rng.uniform(-10, 10, (int(false.sum()), 2))
        observed[name] = seen
    searched = {name: np.ones(count, np.bool_) for name in rig.auxiliaries}
    return TiePoints(core_px, 1 / depth, observed, searched)


def move(camera, degrees=(0.0, 0.0, 0.0), shift_mm=(0.0, 0.0, 0.0)):
    return apply_pose_change(RIG, camera, np.concatenate([np.deg2rad(degrees), shift_mm]))


def assess(tie_points, rig=RIG):
    return assess_tie_points(tie_points, rig, rig.auxiliaries, compute_tolerance(rig, DEPTH_MM))


def make_findings(consistency):
    faults = [PoseFault(fault, "degraded", 0.5) for fault in list_faults(consistency, RIG)]
    return make_pose_findings(consistency, RIG, faults)


@pytest.mark.parametrize("seed", range(8))
def test_sound_rig_has_a_value_and_no_fault_for_every_camera(seed):
    findings = make_findings(assess(make_tie_points(RIG, seed=seed)))
    assert {finding.subject for finding in findings} == {"", *RIG.cameras}
    for finding in findings:
        assert not finding.is_fault
        assert finding.effect == "none"
        assert finding.value < 0.5 * finding.limit


@pytest.mark.parametrize(
    ("camera", "degrees", "shift_mm"),
    [
        ("cam1", (0.05, 0, 0), (0, 0, 0)),
        ("cam2", (0, 0.05, 0), (0, 0, 0)),
        ("cam3", (0, 0, 0), (0.4, 0, 0)),
        ("cam4", (0, 0, 0), (0, 0.4, 0)),
    ],
)
def test_moved_camera_is_named_with_its_size_and_sigma(camera, degrees, shift_mm):
    consistency = assess(make_tie_points(move(camera, degrees, shift_mm)))
    faults = [finding for finding in make_findings(consistency) if finding.is_fault]
    assert [finding.subject for finding in faults] == [camera]
    (fault,) = faults
    assert fault.value > fault.limit
    assert fault.value > 4 * fault.sigma
    assert "mm of depth" in fault.text
    change = consistency.pose_change
    assert change is not None
    truth = np.concatenate([np.deg2rad(degrees), shift_mm])
    sigma = np.sqrt(np.diag(change.covariance))
    assert (np.abs(change.change - truth) < 4 * sigma).all()
    assert change.angle_sigma_deg < 0.03


def test_moved_core_is_a_fault_of_the_core():
    consistency = assess(make_tie_points(move("cam0", (0.08, 0.03, 0))))
    faults = [finding for finding in make_findings(consistency) if finding.is_fault]
    assert [finding.subject for finding in faults] == ["cam0"]


def test_suspected_check_neither_passes_nor_fails():
    consistency = assess(make_tie_points(RIG))
    assert all(np.isnan(f.value) for f in make_pose_findings(consistency, RIG, [], is_suspect=True))


def test_faults_of_the_last_check_hold_without_their_past_error():
    findings = make_findings(assess(make_tie_points(move("cam1", (0.1, 0, 0)))))
    repeated = repeat_faults(findings)
    assert [(f.subject, f.effect, f.systematic_mm) for f in repeated] == [("cam1", "degraded", 0.0)]


def test_frames_before_the_first_check_are_degraded_and_accuse_no_camera():
    unchecked = make_unchecked_finding(12, 10)
    assert (unchecked.check, unchecked.effect) == ("camera_pose_unchecked", "degraded")
    assert not count_unchecked(3, 10).is_fault


def test_missing_and_weak_auxiliaries_reduce_the_redundancy():
    consistency = assess(make_tie_points(RIG))
    names = RIG.auxiliaries
    assert not make_redundancy_finding(names, names, consistency).is_fault
    without = make_redundancy_finding(names, names[1:], consistency)
    assert (without.value, without.effect) == (3, "degraded")
    assert "cam1" in without.text
    blurred = replace(consistency.cameras[2], agreement=0.1)
    weak = replace(consistency, cameras=(*consistency.cameras[:2], blurred, consistency.cameras[3]))
    assert "cam3" in make_redundancy_finding(names, names, weak).text


def accumulate(rigs, *, bias_px=0.0):
    """Return the first contradiction and its number of frames, over one frame per rig."""
    accumulator = ResidualAccumulator(RIG, DEPTH_MM)
    for number, rig in enumerate(rigs):
        accumulator.add(make_tie_points(rig, seed=number, bias_px=bias_px))
        found = accumulator.assess()
        if found is not None:
            return number, found
    return None, None


def test_small_movement_becomes_significant_over_frames():
    moved = move("cam2", (0, 0, 0.03))
    assert assess(make_tie_points(moved)).is_sound
    number, found = accumulate([RIG] * REFERENCE_FRAMES + [moved] * 8)
    assert found is not None
    assert number is not None
    assert found.inconsistent == ("cam2",)
    assert found.is_change
    assert number < REFERENCE_FRAMES + POOLED_FRAMES
    assert worst_effect(make_findings(found)) == "degraded"


def test_sound_rig_with_lens_errors_is_never_accused():
    frames = 40 if THOROUGH else REFERENCE_FRAMES + 2 * POOLED_FRAMES
    number, _ = accumulate([RIG] * frames, bias_px=0.05)
    assert number is None


def test_camera_of_another_instant_is_a_fault_of_synchronisation_not_of_its_pose():
    consistency = assess(make_tie_points(RIG))
    fault = CameraFault((RIG.core,), "one frame older", concerns_core=True, is_of_instant=True)
    findings = make_pose_findings(consistency, RIG, [PoseFault(fault, "missing", 0.0)])
    assert [(one.check, one.subject, one.effect) for one in findings if one.is_fault] == [
        ("camera_sync", RIG.core, "missing")
    ]


def test_undecided_camera_neither_passes_nor_fails():
    consistency = assess(make_tie_points(RIG))
    cameras = tuple(replace(each, state="undecided") for each in consistency.cameras)
    findings = make_pose_findings(replace(consistency, cameras=cameras), RIG, [])
    assert not any(one.is_fault for one in findings)
    assert all(np.isnan(one.value) for one in findings)
