"""Diagnosis of a calibrated rig after the joint adjustment: findings, notes, and what was left out.

What was left out are detected corners, views and frames that the final rig was not found from, with the largest
reason.

The camera network is tested a second time with the lenses of the adjusted rig. The network's first test uses the
lenses that each camera's own views give. A lens that is off makes pairs and loops disagree like a camera that
moved. With the adjusted lenses only what is wrong with the cameras themselves remains.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.assessment.covariance import RigCovariance
from beltscape.calibration.assessment.cross_validation import CrossValidation
from beltscape.calibration.assessment.findings import list_calibration_findings, list_network_findings
from beltscape.calibration.assessment.fit_quality import compute_camera_fits
from beltscape.calibration.assessment.score import RigErrors, project_board, summarise_errors
from beltscape.calibration.assessment.verdict import require_credible
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.calibration.hierarchy import HierarchyResult
from beltscape.calibration.intrinsics.zhang import MonocularCalibration
from beltscape.calibration.network.association import CameraNetwork, associate_cameras
from beltscape.calibration.network.global_optimisation import optimise_network
from beltscape.calibration.network.pairs import calibrate_pairs
from beltscape.calibration.network.resection import fit_board_pose
from beltscape.calibration.solver.lens import fit_view_pose
from beltscape.calibration.solver.levenberg_marquardt import single_thread
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.progress import Silent

MIN_SHIFT = 0.02
"""A start was off if the adjustment moved its focal length by this share of it; good starts are within 0.002."""
AGREEMENT = (
    "pairs of cameras did not agree with the lenses that their own views gave; with those of the joint "
    "adjustment they do"
)


@dataclass(frozen=True, slots=True, eq=False)
class Retest:
    """The network under the adjusted lenses, and what this explains of its first test."""

    hierarchy: HierarchyResult
    """With the network of the adjusted lenses if these refute findings of the first test; else unchanged."""
    notes: tuple[str, ...]
    """What the first test found and the second refutes, in one line each; no faults."""


def retest_network(hierarchy: HierarchyResult, adjustment: BundleAdjustmentResult) -> Retest:
    """Test the network again with the adjusted lenses, if its first test had findings."""
    notes = [*_describe_restarts(hierarchy, adjustment)]
    first = list_network_findings(hierarchy)
    if not first:
        return Retest(hierarchy, tuple(notes))
    try:
        with single_thread():
            again = _rebuild_network(hierarchy, adjustment)
    except CalibrationError:  # no pose fits a pair under these lenses: the first test stands
        return Retest(hierarchy, tuple(notes))
    if len(list_network_findings(again)) >= len(first):
        return Retest(hierarchy, tuple(notes))
    notes += _describe_starts(hierarchy, adjustment) or [AGREEMENT]
    return Retest(again, tuple(notes))


def _rebuild_network(hierarchy: HierarchyResult, adjustment: BundleAdjustmentResult) -> HierarchyResult:
    """Return the hierarchy with pairs and network from the adjusted lenses and the adjusted shape of the board."""
    board_mm, detections = adjustment.geometry.points_mm, hierarchy.detections
    cameras: dict[str, MonocularCalibration] = {}
    for name, own in hierarchy.monocular.items():
        lens: Camera = adjustment.rig.cameras[name]
        views = {frame: detections.views[name][frame] for frame in own.cam_from_board}
        poses = {
            frame: fit_view_pose(lens, board_mm[corners.ids], corners.pixels, refine=True)
            for frame, corners in views.items()
        }
        # rms_px and σ stay those of the camera alone, with which pairs are compared
        cameras[name] = replace(own, camera=lens, cam_from_board=poses)
    pairs = calibrate_pairs(detections, cameras, board_mm, Silent())
    network = optimise_network(associate_cameras(hierarchy.rig.core, pairs))
    return replace(hierarchy, monocular=cameras, network=network)


def _describe_restarts(hierarchy: HierarchyResult, adjustment: BundleAdjustmentResult) -> list[str]:
    """Return one line about the cameras that were started from the lens of like cameras."""
    restarts = [each for each in hierarchy.restarts if each.camera in adjustment.rig.cameras]
    if not restarts:
        return []
    final = _get_focals(adjustment.rig.cameras)
    sizes = ", ".join(
        f"{r.camera} {r.own_focal_px:.4g} px, now {final[r.camera]:.4g} px" for r in restarts[:4]
    )
    more = f" and {len(restarts) - 4} more" if len(restarts) > 4 else ""
    return [
        f"own views hardly determine the focal length of camera {sizes}{more}; they were started again from the "
        "lens of like cameras or the best of several"
    ]


def _describe_starts(hierarchy: HierarchyResult, adjustment: BundleAdjustmentResult) -> list[str]:
    """Return one line for each camera whose lens the joint adjustment corrected far."""
    final = _get_focals(adjustment.rig.cameras)
    lines: list[str] = []
    for name, own in hierarchy.monocular.items():
        start = float(own.camera.focal_px.mean())
        if abs(final[name] - start) > MIN_SHIFT * final[name]:
            lines.append(
                f"the monocular start of camera {name} was off (focal length {start:.4g} px); the joint adjustment "
                f"corrected it to {final[name]:.4g} px"
            )
    return lines


def _get_focals(cameras: Mapping[str, Camera]) -> dict[str, float]:
    return {name: float(np.mean(camera.focal_px)) for name, camera in cameras.items()}


@dataclass(frozen=True, slots=True, eq=False)
class Discards:
    """Views and corners that were left out of the final adjustment."""

    corners: int
    """Corners left out, those of whole views and frames included."""
    all_corners: int
    views: tuple[tuple[str, str], ...]
    """(camera, frame) of the views left out as a whole, those of whole frames included."""
    all_views: int
    frames: Mapping[str, str]
    """Frame left out in all cameras → the reason."""
    all_frames: int

    def describe(self) -> str:
        """Return the counts with the largest reason in one line."""
        if not self.corners:
            return "nothing left out"
        return (
            f"left out: {self.corners} of {self.all_corners} corners, {len(self.views)} of {self.all_views} views, "
            f"{len(self.frames)} of {self.all_frames} frames; {self._describe_reason()}"
        )

    def _describe_reason(self) -> str:
        if self.frames:
            return "; ".join(self.frames.values())
        if not self.views:
            return "single corners that miss the rig by more than 4.5 σ"
        cameras = [camera for camera, _ in self.views]
        most = max(dict.fromkeys(cameras), key=cameras.count)
        own = [frame for camera, frame in self.views if camera == most]
        return f"most views from camera {most}: {', '.join(own[:6])}{' …' * (len(own) > 6)}"

    def document(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return {
            "corners": self.corners,
            "of_corners": self.all_corners,
            "views": [list(view) for view in self.views],
            "of_views": self.all_views,
            "frames": dict(self.frames),
            "of_frames": self.all_frames,
            "words": self.describe(),
        }


def find_discards(hierarchy: HierarchyResult, adjustment: BundleAdjustmentResult) -> Discards:
    """Return the detected corners of the rig's cameras that the final adjustment did not use."""
    used = adjustment.count_used_corners()
    detected = {
        (name, frame): len(corners)
        for name in adjustment.rig.cameras
        for frame, corners in hierarchy.detections.views[name].items()
    }
    views = tuple(view for view in detected if not used.get(view))
    used_frames = {frame for (_, frame), count in used.items() if count}
    frames = dict.fromkeys(frame for _, frame in detected if frame not in used_frames)
    contradicting = hierarchy.contradicting_frames
    gone = tuple((name, each.frame) for each in contradicting for name in each.cameras)
    gone_frames = {
        each.frame: f"frame {each.frame} {'contradicts the others' if each.change else 'has no common instant'}"
        for each in contradicting
        if each.frame not in used_frames
    }
    reasons = {frame: _describe_frame(frame, hierarchy, adjustment) for frame in frames}
    return Discards(
        corners=sum(detected.values()) - sum(used.values()) + sum(each.corners for each in contradicting),
        all_corners=sum(detected.values()) + sum(each.corners for each in contradicting),
        views=(*gone, *views),
        all_views=len(detected) + len(gone),
        frames={**gone_frames, **reasons},
        all_frames=len({frame for _, frame in detected} | set(gone_frames)),
    )


def _describe_frame(frame: str, hierarchy: HierarchyResult, adjustment: BundleAdjustmentResult) -> str:
    """Return why a whole frame was left out, in one line."""
    rms_px, others_px = _compute_frame_rms(frame, hierarchy, adjustment), _compute_used_rms(adjustment)
    return (
        f"frame {frame} is left out in all cameras: its board fits {rms_px / others_px:.0f} times worse than in the "
        f"other frames ({rms_px:.2g} px against {others_px:.2g} px); it was bent or moved, or its corners are "
        "numbered wrongly"
    )


def _compute_frame_rms(frame: str, hierarchy: HierarchyResult, adjustment: BundleAdjustmentResult) -> float:
    """Return the RMS of a frame's residuals under the final rig, px; NaN if no pose fits it."""
    views = {
        name: hierarchy.detections.views[name][frame]
        for name in adjustment.rig.cameras
        if frame in hierarchy.detections.views[name]
    }
    points = adjustment.geometry.points_mm
    try:
        pose = fit_board_pose(adjustment.rig, views, points)
    except CalibrationError:
        return float("nan")
    errors: NDArray[np.float64] = np.concatenate(
        [c.pixels - project_board(adjustment.rig, n, pose, points[c.ids]) for n, c in views.items()]
    )
    squares: NDArray[np.float64] = (errors**2).sum(axis=1)
    return float(np.sqrt(np.nanmean(squares)))


def _compute_used_rms(adjustment: BundleAdjustmentResult) -> float:
    errors = adjustment.bundle.compute_errors_px(adjustment.geometry)[adjustment.used]
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """Diagnosis of a calibration by its final rig."""

    findings: tuple[str, ...]
    """Faults, the likeliest cause first; empty for a sound calibration."""
    notes: tuple[str, ...]
    """What looked like a fault before the joint adjustment and is none, and other remarks."""
    discards: Discards
    network: CameraNetwork
    """The camera network as tested last."""


def diagnose(
    hierarchy: HierarchyResult,
    adjustment: BundleAdjustmentResult,
    covariance: RigCovariance,
    triples: NDArray[np.int64],
    rig_errors: RigErrors,
    validation: CrossValidation | None,
    *,
    explained: Sequence[str] = (),
) -> Diagnosis:
    """Diagnose a calibration by its final rig; ``triples`` (n, 3) are corners in a row of the board.

    ``hierarchy`` has each camera fitted to its own views with the board's measured shape (`refit_own_views`).
    The misfit of the ``explained`` cameras has been reported already.

    Raises
    ------
    CalibrationError
        When the rig is not credible; the line says which views are missing.
    """
    fits, training = compute_camera_fits(rig_errors, triples), summarise_errors(rig_errors)
    if not explained:
        score = validation.score if validation else training
        require_credible(adjustment, covariance, fits, score, training)
    retest = retest_network(hierarchy, adjustment)
    findings = list_calibration_findings(retest.hierarchy, fits, validation, training, explained=explained)
    discards = find_discards(hierarchy, adjustment)
    return Diagnosis(
        tuple(findings), (*retest.notes, *describe_pixels(adjustment)), discards, retest.hierarchy.network
    )


SQUARE_TOLERANCE = 0.01
"""Share by which fx and fy differ from which on pixels are not square; those of sensors are within 0.001."""


def describe_pixels(adjustment: BundleAdjustmentResult) -> list[str]:
    """Return a remark on each camera whose pixels are not square."""
    return [
        f"camera {name}: its pixels are not square, fx/fy = {ratio:.3f}: its images were stretched, or rows or "
        "columns are skipped; that is allowed if all later images are alike"
        for name, camera in adjustment.rig.cameras.items()
        if abs((ratio := float(camera.focal_px[0] / camera.focal_px[1])) - 1) > SQUARE_TOLERANCE
    ]
