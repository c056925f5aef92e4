"""A rig on board views it has never seen."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.calibrate.corners import Sightings
from beltscape.calibrate.fit_quality import FitQuality, assess_fit
from beltscape.calibrate.rig_doubts import rig_doubts, scale_doubt, scale_factor
from beltscape.calibrate.score import Evidence, Score, examine, score
from beltscape.calibrate.sightings import find_board
from beltscape.core.errors import CalibrationError, InputError
from beltscape.core.progress import Reporter
from beltscape.core.rig import Rig
from beltscape.files.capture import read_capture
from beltscape.files.json_text import plain
from beltscape.files.paths import AnyPath, as_path
from beltscape.kernels import load
from beltscape.target.board import Board, corner_points_mm

EXPLAINED = 0.5
"""A wrong scale is the cause where the right one leaves less than this share of the RMS."""
SAME_SQUARE = 0.005
"""Share by which a measured square may differ from the rig's own board and still be of that board."""


@dataclass(frozen=True, slots=True, eq=False)
class RigCheck:
    """A rig, held against board views."""

    score: Score
    evidence: Evidence
    fit: FitQuality
    scale: float
    """Triangulated over stated edge of the board's squares, where they differ for certain; else 1."""


def check(folder: AnyPath, rig: Rig, board: Board, reporter: Reporter) -> RigCheck:
    """Score a rig on board views it has never seen; what speaks against the rig is a warning.

    Raises
    ------
    InputError, CalibrationError
        With one line that names what is wrong and the fix.
    """
    folder = as_path(folder, "folder")
    for line in _other_board(rig, board):
        reporter.warn(line)
    sightings = _sightings(folder, rig, board, reporter)
    board_mm = _known_shape(rig, board)
    board_mm = corner_points_mm(board) if board_mm is None else board_mm
    kernels = load()
    try:
        evidence = examine(rig, sightings, board, kernels, corners_mm=board_mm)
    except CalibrationError as error:
        raise CalibrationError(f"{folder}: {error}") from error
    found = score(evidence)
    factor = scale_factor(board, evidence, found)
    scaled = evidence
    if factor != 1:
        scaled = examine(rig, sightings, board, kernels, corners_mm=factor * board_mm)
        factor = factor if score(scaled).rms_px < EXPLAINED * found.rms_px else 1.0
    doubts: list[str] = []
    if factor != 1:
        _require_same_square(folder, rig, board, factor)
        doubts.append(scale_doubt(board, factor))
    # what the wrong scale alone does is not held against the cameras
    judged = scaled if factor != 1 else evidence
    doubts += rig_doubts(rig, sightings, board, factor * board_mm, judged)
    fit = assess_fit(score(judged), judged, board.grid, doubts)
    for line in fit.doubts:
        reporter.warn(line)
    return RigCheck(found, evidence, fit, factor)


def _sightings(folder: Path, rig: Rig, board: Board, reporter: Reporter) -> Sightings:
    """Return the corners that cameras of the rig see, or InputError where too few or other cameras took them."""
    capture = read_capture(folder)
    for name in rig.cameras:
        if name not in capture.cameras:
            reporter.warn(f"{folder / name}: no images of camera {name}; going on without it")
    known = capture.only(tuple(rig.cameras))
    if len(known.cameras) < 2:
        raise InputError(
            f"{folder}: has the cameras {', '.join(capture.cameras)}, the rig {', '.join(rig.cameras)}; "
            "at least two of them must be the same"
        )
    sightings, _ = find_board(known, board, reporter)
    for name, size in sightings.sizes_px.items():
        if size != rig.cameras[name].size_px:
            width, height = rig.cameras[name].size_px
            raise InputError(
                f"{folder / name}: images are {size[0]}×{size[1]} px, the rig's {name} has {width}×{height}; "
                "check with images of the size the rig was calibrated with"
            )
    return sightings


def _other_board(rig: Rig, board: Board) -> Iterator[str]:
    """Yield a line where the board is described otherwise than the one that the rig was calibrated with."""
    own = _own_board(rig)
    if own is None:
        return
    given = plain(board.model_dump(exclude={"legacy", "inverted"}))
    other = [key for key in given if own.get(key) != given[key]]
    if other:
        told = ", ".join(f"{key} = {given[key]} (the rig's: {own.get(key)})" for key in other)
        yield (
            f"the board is not described as the one the rig was calibrated with: {told}; correct board.toml if it is "
            "the same board"
        )


def _require_same_square(folder: Path, rig: Rig, board: Board, factor: float) -> None:
    """Raise InputError where the squares measure what the rig's own board has, and not what is stated."""
    size = (_own_board(rig) or {}).get("square_mm")
    measured = factor * board.square_mm
    if isinstance(size, int | float) and size != board.square_mm and abs(measured / size - 1) < SAME_SQUARE:
        raise InputError(
            f"{folder}: the board is given with square_mm = {board.square_mm:g}, but its squares measure "
            f"{measured:.4g} mm, as those of the board the rig was calibrated with (square_mm = {size:g}): correct "
            "square_mm in board.toml"
        )


def _known_shape(rig: Rig, board: Board) -> NDArray[np.float64] | None:
    """(P, 3) the board's own shape, where the rig was found with the same board and it was not as drawn."""
    corners = rig.quality.get("board_corners_mm")
    if corners is None or _own_board(rig) != plain(board.model_dump()):
        return None
    points = np.asarray(corners, np.float64)
    return points if points.shape == (board.grid[0] * board.grid[1], 3) else None


def _own_board(rig: Rig) -> dict[str, Any] | None:
    """Return the board that the rig was calibrated with, as rig.json has it; None where it is not known."""
    own = plain(rig.quality.get("board"))
    return own if isinstance(own, dict) else None
