"""Findings against a calibration's fit, and against a rig on new board views, with the likely reason and the fix."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from beltscape.calibration.assessment.cross_validation import CrossValidation
from beltscape.calibration.assessment.fit_quality import (
    PATTERN_PX,
    CameraFit,
    compute_camera_fits,
    estimate_corner_noise_px,
    estimate_residual_sigma_px,
)
from beltscape.calibration.assessment.score import RigErrors, Score, ViewResiduals, project_board
from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.hierarchy import HierarchyResult, find_unsynchronised_pairs
from beltscape.calibration.network.association import Misclosure
from beltscape.calibration.network.contradicting_frames import describe_contradicting_frames
from beltscape.calibration.network.fault_isolation import describe_fault
from beltscape.calibration.network.resection import fit_board_pose
from beltscape.core.arrays import Array
from beltscape.core.checks import is_dict
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.rig import Rig
from beltscape.target.board import Board, corner_points_mm, list_triples

MAX_CHI2, MIN_OPEN_PX = 6.0, 0.25
"""A path or loop is open if its χ² per degree of freedom and its angle in the image exceed these.

Sound sets have at most 1.2 and 0.01 px, blurred or asynchronous views 18 to 440 and 1 to 20 px.
"""
MAX_OVERFIT, MIN_OVERFIT_PX = 1.5, 0.1
"""The views are too few if held-out over training RMS, and their difference, exceed these; sound: below 1.12."""


def list_calibration_findings(
    hierarchy: HierarchyResult,
    fits: Mapping[str, CameraFit],
    halves: CrossValidation | None,
    training: Score,
    *,
    explained: Sequence[str] = (),
) -> list[str]:
    """Return the findings against a calibration, the likeliest cause first; empty for a sound one.

    The misfit of the ``explained`` cameras has been reported already.
    """
    alone = {name: fit for name, fit in fits.items() if name not in explained}
    causes = [
        *describe_contradicting_frames(hierarchy.contradicting_frames),
        *_find_asynchronous(hierarchy),
        *_find_fault(hierarchy),
        *_find_own_misfit(hierarchy, alone),
    ]
    if not causes and not explained:
        causes = describe_pattern([name for name, fit in fits.items() if fit.is_pattern()], fits, TOGETHER)
    return [*causes, *_find_open_loops(hierarchy), *_find_overfit(halves, training)]


def list_network_findings(hierarchy: HierarchyResult) -> list[str]:
    """Return the findings of pairs, of the loops' fault isolation, and of open loops."""
    return [*_find_asynchronous(hierarchy), *_find_fault(hierarchy), *_find_open_loops(hierarchy)]


TOGETHER = (
    "the cameras do not fit together: they are not triggered at the same instant, or one of them moved between "
    "views; check trigger and mounts"
)
ALONE = (
    "the lens model or the board does not explain the views: look for a wide-angle lens, a board that bends, views "
    "out of focus, motion blur or a rolling shutter, and take new views of a rigid board that stands still"
)


def describe_pattern(names: Sequence[str], fits: Mapping[str, CameraFit], reason: str) -> list[str]:
    """Return the finding that residuals of these cameras are more than noise; empty without a camera."""
    if not names:
        return []
    sizes = ", ".join(
        f"camera {name} {fits[name].sigma_px:.2g} px against {fits[name].corner_noise_px:.2g} px"
        for name in names
    )
    return [f"residuals are a pattern, far larger than the corners' own noise ({sizes}): {reason}"]


def _find_asynchronous(hierarchy: HierarchyResult) -> list[str]:
    """Return the finding that pairs fit worse than their cameras alone."""
    unsynchronised = find_unsynchronised_pairs(hierarchy)
    if not unsynchronised:
        return []
    sizes = ", ".join(f"{pair.first}–{pair.second} {pair.rms_px:.2f} px" for pair in unsynchronised)
    alone = max(
        hierarchy.monocular[name].rms_px for pair in unsynchronised for name in (pair.first, pair.second)
    )
    return [
        f"cameras fit worse together than alone (at most {alone:.2f} px): {sizes}; they are not triggered at the "
        "same instant, or one of them moved"
    ]


def _find_fault(hierarchy: HierarchyResult) -> list[str]:
    """Return the finding of the camera or pair whose loops are open."""
    fault = describe_fault(hierarchy.network)
    return [] if fault is None else [fault]


def _find_own_misfit(hierarchy: HierarchyResult, fits: Mapping[str, CameraFit]) -> list[str]:
    """Return the finding that cameras do not fit their own views, independently of the other cameras."""
    own_fits = {
        name: CameraFit(hierarchy.monocular[name].rms_px / np.sqrt(2), fit.corner_noise_px)
        for name, fit in fits.items()
    }
    return describe_pattern(
        [name for name in fits if own_fits[name].is_pattern() and fits[name].is_pattern()], own_fits, ALONE
    )


def _find_open_loops(hierarchy: HierarchyResult) -> list[str]:
    """Return the finding of open paths and loops, with the one that closes worst."""
    network = hierarchy.network
    errors = (*network.path_errors, *network.loop_errors)
    open_ones = [
        error
        for error in errors
        if error.chi2_per_dof > MAX_CHI2
        and _compute_angle_px(error, (hierarchy.rig.cameras[n] for n in error.cameras)) > MIN_OPEN_PX
    ]
    if not open_ones:
        return []
    worst = max(open_ones, key=lambda error: error.chi2_per_dof)
    return [
        f"{len(open_ones)} of {len(errors)} paths and loops of the camera network do not close: worst "
        f"{'–'.join(worst.cameras)} with χ² {worst.chi2_per_dof:.1f} per degree of freedom (1 where noise explains "
        f"it), {worst.rotation_deg:.2g}° and {worst.translation_mm:.2g} mm"
    ]


def _compute_angle_px(error: Misclosure, cameras: Iterable[Camera]) -> float:
    """Return a misclosure's rotation as a shift in the images, px."""
    return float(np.deg2rad(error.rotation_deg) * max(camera.focal_px.mean() for camera in cameras))


def _find_overfit(halves: CrossValidation | None, training: Score) -> list[str]:
    """Return the finding that views are too few or too alike."""
    if halves is None:
        return []
    rms_px = halves.score.rms_px
    if rms_px < MAX_OVERFIT * training.rms_px or rms_px - training.rms_px < MIN_OVERFIT_PX:
        return []
    return [
        f"on held-out views the RMS is {rms_px:.3g} px, {rms_px / training.rms_px:.1f} times the "
        f"{training.rms_px:.3g} px on the views the rig was found from: these are too few or too alike; add views "
        "with the board tilted to every side and in every corner of the images"
    ]


MAX_GROWTH, MIN_LIMIT_PX = 3.0, 0.02
"""Limit of a rig's residuals, as a multiple of those on its held-out views, and the least limit in px."""
MAX_SHARE_WITHOUT = 0.5
"""A camera is reported if the residuals without it fall below this share, of all and of those without another."""
MOVED_PX = 0.4
"""σ of the residuals from which a camera is said to have been moved while views are taken: few views leave a lens
uncertain by up to 0.2 px where the board has not been."""
MAX_SCALE_ERROR = 0.002
"""Largest relative error of the mean triangulated edge; sound sets have at most 0.0005."""
LENS = (
    "their intrinsics do not fit these views: focus, zoom or crop changed since the calibration, it is another "
    "camera, or the board bends; calibrate anew"
)
MIN_STANDARD_ERRORS = 4.0
"""Standard errors of that mean, from its scatter between frames, above which it is significant."""


def list_rig_findings(
    rig: Rig, detections: BoardDetections, board: Board, board_mm: Array, rig_errors: RigErrors
) -> list[str]:
    """Return why these views contradict a rig, by the likeliest cause; empty if they do not."""
    fits, limit_px = compute_camera_fits(rig_errors, list_triples(board)), _compute_limit_px(rig)
    patterned = [name for name, fit in fits.items() if fit.is_pattern(limit_px)]
    if not patterned:
        return []
    alone = {name: _fit_alone(rig, detections, name, board, board_mm) for name in fits}
    lenses = [name for name, fit in alone.items() if fit.is_pattern(limit_px)]
    if lenses:
        return describe_pattern(lenses, fits, LENS)
    return describe_pattern(patterned, fits, _describe_displacement(rig, detections, board_mm))


def _compute_limit_px(rig: Rig) -> float:
    """Return the limit of σ of this rig's residuals: far above that on its held-out views, px."""
    held_out = rig.quality.get("held_out")
    held_out_rms = held_out.get("rms_px") if is_dict(held_out) else None
    if not isinstance(held_out_rms, int | float):
        return PATTERN_PX
    return min(PATTERN_PX, max(MIN_LIMIT_PX, MAX_GROWTH * held_out_rms / 2**0.5))


def estimate_scale_factor(board: Board, rig_errors: RigErrors, score: Score) -> float:
    """Return triangulated over stated edge of a square if they differ significantly, else exactly 1."""
    factor = 1 + score.square_bias_mm / board.square_mm
    certain = abs(score.square_bias_mm) > MIN_STANDARD_ERRORS * rig_errors.compute_edge_bias_error_mm()
    return factor if certain and abs(factor - 1) > MAX_SCALE_ERROR else 1.0


def describe_scale(board: Board, factor: float) -> str:
    """Return the finding that the board's squares, or the rig's baselines, have another size than stated."""
    return (
        f"with this rig the board's squares measure {board.square_mm * factor:.4g} mm, not {board.square_mm:g} mm "
        f"(factor {factor:.4f}): either square_mm of this board is wrong, or the one the rig was calibrated with "
        "was; measure both over many squares"
    )


def _describe_displacement(rig: Rig, detections: BoardDetections, board_mm: Array) -> str:
    """Return the description of the displaced camera, as far as it can be isolated."""
    camera, without_px = _isolate_displacement(rig, detections, board_mm)
    if camera:
        return (
            f"camera {camera} does not fit the others (without it they fit within {without_px:.2g} px): "
            "it or its lens was moved, its folder is another camera's, or it is not triggered with the others; fix "
            "it and calibrate anew"
        )
    names = _list_seeing(rig, detections)
    return (
        f"each of {', '.join(names)} fits by itself, together they do not: a camera was moved, folders are swapped, "
        "or they are not triggered at the same instant; calibrate anew"
    )


def _list_seeing(rig: Rig, detections: BoardDetections) -> list[str]:
    return [name for name in rig.cameras if name in detections.cameras and detections.views[name]]


def _isolate_displacement(rig: Rig, detections: BoardDetections, board_mm: Array) -> tuple[str, float]:
    """Return the camera without which the others fit, and within how many px; an empty name where none stands out."""
    names = _list_seeing(rig, detections)
    whole = _fit_together(rig, detections, names, board_mm)
    without = {
        name: _fit_together(rig, detections, [n for n in names if n != name], board_mm)
        for name in names
        if len(names) > 2
    }
    ordered = sorted(without, key=lambda name: without[name])
    if ordered and without[ordered[0]] < MAX_SHARE_WITHOUT * min(whole, without[ordered[1]]):
        return ordered[0], without[ordered[0]]
    return "", float("nan")


def find_displaced_camera(rig: Rig, detections: BoardDetections, board: Board) -> str:
    """Return the camera that was moved since a rig was calibrated, by a few views; empty: none contradicts.

    Of two cameras that contradict each other it is not known which was moved; then it is empty, too. So it is where a
    camera does not fit its own views: then its lens is not known there.
    """
    board_mm = corner_points_mm(board)
    names = _list_seeing(rig, detections)
    if len(names) < 3 or _fit_together(rig, detections, names, board_mm) <= MOVED_PX:
        return ""
    camera, _ = _isolate_displacement(rig, detections, board_mm)
    is_lens = camera and _fit_alone(rig, detections, camera, board, board_mm).sigma_px > MOVED_PX
    return "" if is_lens else camera


def _fit_together(rig: Rig, detections: BoardDetections, names: Iterable[str], board_mm: Array) -> float:
    """Return the robust σ of these cameras' residuals in the frames that two of them see, px; ∞ without any."""
    errors: list[Array] = []
    for frame in detections.frames:
        views = {name: detections.views[name][frame] for name in names if frame in detections.views[name]}
        if len(views) > 1:
            pose = fit_board_pose(rig, views, board_mm)
            errors += [c.pixels - project_board(rig, n, pose, board_mm[c.ids]) for n, c in views.items()]
    return estimate_residual_sigma_px(errors) if errors else float("inf")


def _fit_alone(rig: Rig, detections: BoardDetections, name: str, board: Board, board_mm: Array) -> CameraFit:
    """Return the fit of one camera to its own views, with board poses from it alone."""
    views: list[ViewResiduals] = []
    for corners in detections.views[name].values():
        pose = fit_board_pose(rig, {name: corners}, board_mm)
        errors = corners.pixels - project_board(rig, name, pose, board_mm[corners.ids])
        views.append(ViewResiduals(corners.ids, corners.pixels, errors))
    return CameraFit(
        estimate_residual_sigma_px(view.errors_px for view in views),
        estimate_corner_noise_px(views, list_triples(board)),
    )
