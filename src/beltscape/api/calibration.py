"""Calibration of a rig from a capture of board views."""

from __future__ import annotations

from beltscape.core.progress import Reporter, Silent
from beltscape.files.exchange import read_intrinsics
from beltscape.files.folders.paths import AnyPath, as_path
from beltscape.pipeline.calibrating import calibration
from beltscape.pipeline.calibrating.calibration import Calibration
from beltscape.pipeline.calibrating.known_intrinsics import KnownIntrinsics
from beltscape.target.board import Board, read_board


def calibrate(
    capture: AnyPath,
    board: Board | AnyPath,
    core: str | None = None,
    *,
    intrinsics: AnyPath | None = None,
    reporter: Reporter | None = None,
) -> Calibration:
    """Calibrate the rig of a capture of board views (the paper's Section 2.2).

    Parameters
    ----------
    capture
        Folder with one folder of images per camera.
    board
        The board, or the path of its board.toml.
    core
        Name of the core camera; None: the best connected one.
    intrinsics
        A rig.json or another file with known intrinsics, which are then fixed.
    reporter
        Receiver of progress and warnings; without one, only the result's ``warnings`` hold them.

    Returns
    -------
    The calibration, with ``rig``, ``score`` and ``warnings``.

    Raises
    ------
    InputError, CalibrationError
        with one line that names the fault and the fix.
    """
    board = board if isinstance(board, Board) else read_board(as_path(board, "board"))
    reporter = reporter or Silent()
    known = None
    if intrinsics is not None:
        known = KnownIntrinsics(read_intrinsics(as_path(intrinsics, "intrinsics"), reporter), str(intrinsics))
    return calibration.calibrate(as_path(capture, "capture"), board, core, reporter, known=known)
