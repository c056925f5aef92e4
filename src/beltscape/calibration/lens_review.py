"""Second choice of the lens models, with the board's shape that the joint adjustment measured.

In the first choice every camera sees the board as drawn. A board that is bent by a fifth of a millimetre then leaves
more than a wrong lens does, and hides it.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.calibration.hierarchy import HierarchyResult
from beltscape.calibration.intrinsics.lens_choice import LensChoice, calibrate_with_model
from beltscape.calibration.solver.levenberg_marquardt import single_thread
from beltscape.core.errors import CalibrationError
from beltscape.target.board import Board, corner_points_mm

MAX_ROUNDS = 2
"""Largest number of repeated choices: the shape that a right lens leaves changes a second choice in no set tried."""


def review_lenses(
    hierarchy: HierarchyResult, adjustment: BundleAdjustmentResult, board: Board
) -> dict[str, LensChoice]:
    """Return the lens models that the cameras' views choose with the board's measured shape, by camera.

    Empty without a measured shape; models that were asked for or given are no choice.
    """
    found: dict[str, LensChoice] = {}
    if not np.any(adjustment.shape_mm):
        return found
    drawn_mm, board_mm = corner_points_mm(board), adjustment.geometry.points_mm
    with single_thread():
        for choice in hierarchy.lens_choices:
            if choice.is_requested:
                continue
            with suppress(CalibrationError):
                found[choice.camera] = calibrate_with_model(
                    choice.camera, hierarchy.detections, board_mm,
                    drawn_mm=drawn_mm, start=hierarchy.monocular[choice.camera],
                )[1]  # fmt: skip
    return found


def find_changed(hierarchy: HierarchyResult, choices: dict[str, LensChoice]) -> list[str]:
    """Return the cameras whose lens model differs from the one that they were adjusted with."""
    return [name for name in choices if choices[name].model != hierarchy.rig.cameras[name].model]
