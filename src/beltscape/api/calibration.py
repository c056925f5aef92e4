"""Calibration of a rig from a capture of board views."""

from __future__ import annotations

from typing import Literal

from beltscape.calibration.intrinsics.lens_choice import AUTO
from beltscape.calibration.result import Calibration
from beltscape.core.checks import require_choice, require_reporter, require_text, show_value
from beltscape.core.errors import InputError
from beltscape.core.geometry.lens import MODELS
from beltscape.core.progress import Reporter, Silent
from beltscape.files.paths import AnyPath, as_path
from beltscape.pipeline.calibrating import calibration
from beltscape.pipeline.calibrating.intrinsics import IntrinsicsUse, read_known_intrinsics
from beltscape.pipeline.calibrating.measuring_volume import read_measuring_volume
from beltscape.target.board import Board, read_board

LensChoice = Literal["auto", "brown", "rational", "thin_prism", "tilted", "fisheye"]


def calibrate(
    capture: AnyPath,
    board: Board | AnyPath,
    core: str | None = None,
    *,
    intrinsics: AnyPath | None = None,
    intrinsics_as: IntrinsicsUse = "held",
    lens_model: LensChoice = "auto",
    belt: AnyPath | None = None,
    reporter: Reporter | None = None,
) -> Calibration:
    """Calibrate the rig of a capture of board views (the paper's Section 2.2).

    >>> calibration = bs.calibrate(demo / "calibration", board=demo / "board.toml", core="cam0")

    Parameters
    ----------
    capture
        Folder with one folder of images per camera.
    board
        The board, or the path of its board.toml.
    core
        Name of the core camera; None: the best connected one.
    intrinsics
        An intrinsics.json, a rig.json or another file with known intrinsics, or a folder of views for them.
    intrinsics_as
        ``held``: they are fixed; ``prior``: the views improve them within their covariance.
    lens_model
        "brown", "rational", "thin_prism", "tilted" or "fisheye", for all cameras; "auto": each camera's views choose.
    belt
        A plan.toml, project.toml or belt.json: the volume over the belt whose part of the images the board must have
        reached; None: the core camera's whole view.
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
    if not isinstance(lens_model, str) or lens_model not in (AUTO, *MODELS):
        raise InputError(
            f"lens_model = {show_value(lens_model)}: must be {AUTO} or one of {', '.join(MODELS)}"
        )
    require_choice(intrinsics_as, "intrinsics_as", ("held", "prior"))
    require_text("core" if core is None else core, "core")
    require_reporter(reporter)
    board = board if isinstance(board, Board) else read_board(as_path(board, "board"))
    reporter = reporter or Silent()
    known = None
    if intrinsics is not None:
        known = read_known_intrinsics(as_path(intrinsics, "intrinsics"), board, reporter, use=intrinsics_as)
    volume = None if belt is None else read_measuring_volume(as_path(belt, "belt"))
    return calibration.calibrate(
        as_path(capture, "capture"), board, core, reporter, known=known, lens_model=lens_model, volume=volume
    )
