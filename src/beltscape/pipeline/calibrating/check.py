"""Check of a rig on board views that it was not calibrated with."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.assessment.findings import describe_scale, estimate_scale_factor, list_rig_findings
from beltscape.calibration.assessment.fit_quality import FitQuality, assess_fit
from beltscape.calibration.assessment.score import RigErrors, Score, compute_rig_errors, summarise_errors
from beltscape.calibration.detection.corners import BoardDetections
from beltscape.core.checks import is_dict
from beltscape.core.errors import CalibrationError, InputError
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.files.capture import read_capture
from beltscape.files.json_text import to_plain
from beltscape.files.paths import AnyPath, as_path
from beltscape.kernels import load_on_processor
from beltscape.pipeline.calibrating.board_sets import resolve_checked_set
from beltscape.pipeline.calibrating.views import detect_rig_board
from beltscape.sources.folder import describe_lost_camera, scale_rig_to_capture
from beltscape.target.board import Board, corner_points_mm, list_triples, parse_board

MAX_REMAINING_RMS = 0.5
"""A wrong scale is the cause if the right one leaves less than this share of the RMS."""
SQUARE_TOLERANCE = 0.005
"""Relative difference up to which a measured square is taken to be of the rig's own board."""


@dataclass(frozen=True, slots=True, eq=False)
class RigCheck:
    """Result of checking a rig on board views."""

    score: Score
    rig_errors: RigErrors
    fit: FitQuality
    scale: float
    """Triangulated over stated edge of the board's squares, if they differ significantly; else 1."""


def check(folder: AnyPath, rig: Rig, board: Board, reporter: Reporter) -> RigCheck:
    """Score a rig on board views that it was not calibrated with; findings against it are warnings.

    Raises
    ------
    InputError, CalibrationError
        With one line that names the fault and the fix.
    """
    folder = as_path(folder, "folder")
    rig = scale_rig_to_capture(rig, folder, reporter)
    for line in _describe_board_differences(rig, board):
        reporter.warn(line)
    detections = _detect_board(folder, rig, board, reporter)
    detections, board = resolve_checked_set(detections, board, rig)
    board_mm = _read_board_shape(rig, board)
    board_mm = corner_points_mm(board) if board_mm is None else board_mm
    kernels = load_on_processor()
    try:
        rig_errors = compute_rig_errors(rig, detections, board, kernels, corners_mm=board_mm)
    except CalibrationError as error:
        raise CalibrationError(f"{folder}: {error}") from error
    score = summarise_errors(rig_errors)
    factor = estimate_scale_factor(board, rig_errors, score)
    scaled_errors = rig_errors
    if factor != 1:
        scaled_errors = compute_rig_errors(rig, detections, board, kernels, corners_mm=factor * board_mm)
        factor = factor if summarise_errors(scaled_errors).rms_px < MAX_REMAINING_RMS * score.rms_px else 1.0
    findings: list[str] = []
    if factor != 1:
        _require_same_square(folder, rig, board, factor)
        findings.append(describe_scale(board, factor))
    # errors from the wrong scale alone are not attributed to the cameras
    assessed_errors = scaled_errors if factor != 1 else rig_errors
    findings += list_rig_findings(rig, detections, board, factor * board_mm, assessed_errors)
    fit = assess_fit(summarise_errors(assessed_errors), assessed_errors, list_triples(board), findings)
    for line in fit.findings:
        reporter.warn(line)
    return RigCheck(score, rig_errors, fit, factor)


def _detect_board(folder: Path, rig: Rig, board: Board, reporter: Reporter) -> BoardDetections:
    """Return the corners that the rig's cameras see; raise InputError if these are too few or have other sizes."""
    capture = read_capture(folder, rig.cameras)
    for name in rig.cameras:
        if name not in capture.cameras:
            reporter.warn(describe_lost_camera(str(folder), name, capture.cameras, rig.cameras))
    common = capture.select_cameras(tuple(rig.cameras))
    if len(common.cameras) < 2:
        raise InputError(
            f"{folder}: has the cameras {', '.join(capture.cameras)}, the rig {', '.join(rig.cameras)}"
            f"{capture.explain(*rig.cameras)}; at least two of them must be the same"
        )
    detections, _ = detect_rig_board(common, board, reporter, known=rig.cameras)
    for name, size in detections.sizes_px.items():
        if size != rig.cameras[name].size_px:
            width, height = rig.cameras[name].size_px
            raise InputError(
                f"{folder / name}: images are {size[0]}×{size[1]} px, the rig's {name} has {width}×{height}; "
                "check with images of the size the rig was calibrated with"
            )
    return detections


def _describe_board_differences(rig: Rig, board: Board) -> Iterator[str]:
    """Yield a line if the board's description differs from that of the rig's calibration."""
    rig_board = _get_rig_board(rig)
    if rig_board is None:
        return
    rig_board = _get_front(rig_board)
    given = _drop_sigma(to_plain(board.model_dump(exclude={"legacy", "inverted"})))
    differing = [key for key in given if rig_board.get(key) != given[key]]
    if differing:
        differences = ", ".join(
            f"{key} = {given[key]} (the rig's: {rig_board.get(key)})" for key in differing
        )
        yield (
            f"the board is not described as the one the rig was calibrated with: {differences}; correct board.toml "
            "if it is the same board"
        )


def _require_same_square(folder: Path, rig: Rig, board: Board, factor: float) -> None:
    """Raise InputError if the squares measure as those of the rig's own board, not as stated."""
    size = _get_front(_get_rig_board(rig) or {}).get("square_mm")
    measured = factor * board.square_mm
    if (
        isinstance(size, int | float)
        and size != board.square_mm
        and abs(measured / size - 1) < SQUARE_TOLERANCE
    ):
        raise InputError(
            f"{folder}: the board is given with square_mm = {board.square_mm:g}, but its squares measure "
            f"{measured:.4g} mm, as those of the board the rig was calibrated with (square_mm = {size:g}): correct "
            "square_mm in board.toml"
        )


def _read_board_shape(rig: Rig, board: Board) -> NDArray[np.float64] | None:
    """Return the board's shape (P, 3) if the rig was calibrated with this board and it deviates from the drawing."""
    corners = rig.quality.get("board_corners_mm")
    if corners is None or _drop_sigma(_get_rig_board(rig)) != _drop_sigma(to_plain(board.model_dump())):
        return None
    points = np.asarray(corners, np.float64)
    return points if points.shape == corner_points_mm(board).shape else None


def _drop_sigma(board: Any) -> Any:
    """Return a board's description without the σ of its certificate, which is no property of its print."""
    if is_dict(board):
        return {key: _drop_sigma(value) for key, value in board.items() if not key.endswith("_sigma_mm")}
    return [_drop_sigma(each) for each in board] if isinstance(board, list) else board


def _get_front(rig_board: dict[str, Any]) -> dict[str, Any]:
    """Return the board whose print is on both sides, if it is; else the board as it is."""
    faces = rig_board.get("faces")
    return faces[0]["board"] if faces and faces[-1].get("from_behind") else rig_board


def _get_rig_board(rig: Rig) -> dict[str, Any] | None:
    """Return the board of the rig's calibration from rig.json; None if it is unknown."""
    rig_board = to_plain(rig.quality.get("board"))
    if not is_dict(rig_board):
        return None
    try:  # keys that the rig's version did not know yet get their defaults
        return to_plain(parse_board(Path("rig.json"), rig_board).model_dump())
    except InputError:
        return rig_board
