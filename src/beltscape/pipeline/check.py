"""A rig on board views it has never seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beltscape.calibrate.score import Evidence, Score, examine, score
from beltscape.calibrate.sightings import find_board
from beltscape.core.errors import CalibrationError, InputError
from beltscape.core.progress import Reporter
from beltscape.core.rig import Rig
from beltscape.files.capture import read_capture
from beltscape.files.json_text import plain
from beltscape.kernels import load
from beltscape.target.board import Board


def check(folder: Path, rig: Rig, board: Board, reporter: Reporter) -> tuple[Score, Evidence]:
    """Score a rig on board views it has never seen.

    Raises
    ------
    InputError, CalibrationError
        With one line that names what is wrong and the mend.
    """
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
    try:
        evidence = examine(rig, sightings, board, load(), corners_mm=_known_shape(rig, board))
    except CalibrationError as error:
        raise CalibrationError(f"{folder}: {error}") from error
    return score(evidence), evidence


def _known_shape(rig: Rig, board: Board) -> NDArray[np.float64] | None:
    """(P, 3) the board's own shape, where the rig was found with the same board and it was not as drawn."""
    corners = rig.quality.get("board_corners_mm")
    if corners is None or rig.quality.get("board") != plain(board.model_dump()):
        return None
    points = np.asarray(corners, np.float64)
    return points if points.shape == (board.grid[0] * board.grid[1], 3) else None
