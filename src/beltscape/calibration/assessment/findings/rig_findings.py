"""Findings against a rig on new board views, with the likely reason and the fix."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.assessment.findings.fit_findings import describe_pattern
from beltscape.calibration.assessment.validation.corner_noise import estimate_corner_noise_px
from beltscape.calibration.assessment.validation.fit_quality import (
    PATTERN_PX,
    CameraFit,
    compute_camera_fits,
    estimate_residual_sigma_px,
)
from beltscape.calibration.assessment.validation.score import RigErrors, Score, ViewResiduals, project_board
from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.network.resection import fit_board_pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.type_guards import is_dict
from beltscape.target.board import Board, list_triples

Array = NDArray[np.float64]

MAX_GROWTH, MIN_LIMIT_PX = 3.0, 0.02
"""Limit of a rig's residuals, as a multiple of those on its held-out views, and the least limit in px."""
MAX_SHARE_WITHOUT = 0.5
"""A camera is reported if the residuals without it fall below this share, of all and of those without another."""
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
    names = [name for name in rig.cameras if name in detections.cameras and detections.views[name]]
    whole = _fit_together(rig, detections, names, board_mm)
    without = {
        name: _fit_together(rig, detections, [n for n in names if n != name], board_mm)
        for name in names
        if len(names) > 2
    }
    ordered = sorted(without, key=lambda name: without[name])
    if ordered and without[ordered[0]] < MAX_SHARE_WITHOUT * min(whole, without[ordered[1]]):
        return (
            f"camera {ordered[0]} does not fit the others (without it they fit within {without[ordered[0]]:.2g} px): "
            "it or its lens was moved, its folder is another camera's, or it is not triggered with the others; fix "
            "it and calibrate anew"
        )
    return (
        f"each of {', '.join(names)} fits by itself, together they do not: a camera was moved, folders are swapped, "
        "or they are not triggered at the same instant; calibrate anew"
    )


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
