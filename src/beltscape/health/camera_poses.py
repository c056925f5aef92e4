"""Findings about the poses of the cameras: the size of a contradiction in mm of depth, with σ and limit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from beltscape.core.alarm_catalogue import CAMERA_POSE, CAMERA_POSE_UNCHECKED, CAMERA_SYNC
from beltscape.core.findings import Effect, Finding
from beltscape.core.geometry.rig import Rig
from beltscape.core.translatable_message import make_message
from beltscape.stereo.consistency.diagnosis import CameraFault
from beltscape.stereo.consistency.rig_consistency import CameraConsistency, RigConsistency

_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class PoseFault:
    """A fault of cameras with its consequence for the frame."""

    fault: CameraFault
    effect: Effect
    systematic_mm: float
    """Error of the depth that the cameras may have caused since the last check, mm."""


def make_pose_findings(
    consistency: RigConsistency, rig: Rig, faults: Sequence[PoseFault], *, is_suspect: bool = False
) -> tuple[Finding, ...]:
    """Return a finding for each camera, and one for the rig as a whole (without subject).

    With ``is_suspect`` the check neither passed nor failed, so that a fault found later reaches back before it.
    """
    measured = [_make_finding(each) for each in consistency.cameras]
    finite = [finding for finding in measured if np.isfinite(finding.value)]
    # a movement of the core shows in all auxiliaries: in the least of them, too
    core = min(
        finite, key=lambda finding: finding.value, default=Finding(CAMERA_POSE, _NAN, _NAN, _NAN, "mm")
    )
    whole = max(finite, key=lambda finding: finding.value, default=core)
    findings = [replace(whole, subject=""), replace(core, subject=rig.core), *measured]
    if is_suspect:
        findings = [replace(finding, value=_NAN) for finding in findings]
    poses = [each for each in faults if not each.fault.is_of_instant]
    instants = [_make_instant_finding(each) for each in faults if each.fault.is_of_instant]
    return (*(_add_faults(finding, poses) for finding in findings), *instants)


def _make_instant_finding(each: PoseFault) -> Finding:
    """Return the finding of a camera whose images are of another instant; by how much is not measured."""
    (camera,) = each.fault.cameras
    return Finding(
        CAMERA_SYNC, _NAN, _NAN, _NAN, "ms", camera, each.fault.text, each.effect, each.systematic_mm
    )


def make_unreliable_finding(text: str) -> Finding:
    """Return the finding of a frame whose few pixels match by chance, because no image fits the rig."""
    message = make_message("camera_pose_unreliable", detail=text)
    return Finding(CAMERA_POSE, _NAN, _NAN, _NAN, "mm", "", message, "missing")


def count_unchecked(frames: int, limit: int) -> Finding:
    """Return how many frames have passed since one last showed whether the cameras agree with the rig."""
    return Finding(CAMERA_POSE_UNCHECKED, float(frames), 0.0, float(limit), "")


def make_unchecked_finding(frames: int, limit: int) -> Finding:
    """Return the finding that the poses are not known to be right, although nothing shows that they are wrong."""
    finding = count_unchecked(frames, limit)
    return replace(finding, text=make_message("camera_pose_unchecked"), effect="degraded")


def repeat_faults(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return the faults of the last check for a frame that was not checked; excluded cameras cause no more error."""
    return tuple(replace(finding, systematic_mm=0.0) for finding in findings if finding.is_fault)


def _make_finding(each: CameraConsistency) -> Finding:
    sigma, limit = (px * each.depth_mm_per_px for px in (each.epipolar_sigma_px, each.tolerance_px))
    value = _NAN if each.state == "undecided" else each.depth_error_mm
    return Finding(CAMERA_POSE, value, sigma, limit, "mm", each.camera)


def _add_faults(finding: Finding, faults: Sequence[PoseFault]) -> Finding:
    """Return the finding with the faults of its camera; those without a camera belong to the whole rig."""
    own = [each for each in faults if finding.subject in (each.fault.cameras or ("",))]
    if not own:
        return finding
    worst = max(own, key=lambda each: each.effect == "missing")
    return replace(
        finding,
        text=own[0].fault.text if len(own) == 1 else "; ".join(each.fault.text for each in own),
        effect=worst.effect,
        systematic_mm=max(each.systematic_mm for each in own),
    )
