"""Plausibility of a calibrated rig: cameras at one place, boards of another unit, halves that disagree."""

from __future__ import annotations

from collections.abc import Collection
from itertools import combinations
from pathlib import Path

import numpy as np

from beltscape.calibration.assessment.domain.lens_domain import limit_domains
from beltscape.calibration.assessment.validation.cross_validation import CrossValidation
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.calibration.hierarchy import HierarchyResult
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.rig import Rig
from beltscape.core.plausibility import guess_unit_of_board
from beltscape.core.progress import Reporter
from beltscape.files.rig_limits import find_refusal
from beltscape.target.board import Board

MAX_SPLIT_RATIO = 2.0
"""Ratio of the halves' depth differences to their standard deviation above which the stated σ are too small."""
MIN_BASELINE = 1e-3
"""Least baseline over the board's distance for which depth can be measured; planned rigs have 0.1 and more."""
MIN_DISTANCE_MM, MAX_DISTANCE_MM = 150.0, 30_000.0
"""Plausible distances of a board; outside them its size was probably given in another unit."""


def require_baselines(hierarchy: HierarchyResult, folder: Path) -> None:
    """Raise CalibrationError if two cameras are at the same place: they measure no depth."""
    centers = {name: pose.center_mm for name, pose in hierarchy.rig.cam_from_core.items()}
    boards = [
        pose.translation_mm[2]
        for camera in hierarchy.monocular.values()
        for pose in camera.cam_from_board.values()
    ]
    for first, second in combinations(centers, 2):
        baseline = float(np.linalg.norm(centers[first] - centers[second]))
        if baseline < MIN_BASELINE * float(np.median(boards)):
            raise CalibrationError(
                f"{folder}: cameras {first} and {second} stand at the same place ({baseline:.2g} mm apart); are the "
                f"images of one a copy of the other's? Give each camera its own"
            )


def warn_of_split(halves: CrossValidation | None, reporter: Reporter) -> None:
    """Warn if the stated standard deviations are too small."""
    if halves is not None and halves.split_ratio > MAX_SPLIT_RATIO:
        reporter.warn(
            f"the rigs of even and odd frames differ {halves.split_ratio:.1f} times more than their standard "
            "deviations allow: the stated σ are too small; look for moving cameras, blur or a bending board"
        )


def limit_lenses(
    board: Board, adjustment: BundleAdjustmentResult, known: Collection[str], reporter: Reporter
) -> Rig:
    """Return the adjusted rig with the domains in which its lenses, except those of ``known`` cameras, are known.

    Its size is checked by `check_scale`.
    """
    limited = limit_domains(adjustment.rig, adjustment, known)
    check_scale(board, adjustment, limited, reporter)
    return limited


def check_scale(board: Board, adjustment: BundleAdjustmentResult, rig: Rig, reporter: Reporter) -> None:
    """Warn if the board's size makes an unusual rig, with the unit that it was probably given in.

    Raises
    ------
    CalibrationError
        If the rig could not be read again, because its size or a lens is impossible.
    """
    distance = float(np.median(adjustment.geometry.board_translation_mm[:, 2]))
    baseline = max(
        (float(np.linalg.norm(pose.center_mm)) for pose in rig.cam_from_core.values()), default=0.0
    )
    units = guess_unit_of_board(board.square_mm, distance, baseline)
    guess = " or ".join(f"{unit} ({_round(board.square_mm * factor)} mm)" for unit, factor in units)
    text = (
        f"with square_mm = {board.square_mm:g} the board was {distance:.3g} mm away and the cameras up to "
        f"{baseline:.3g} mm apart"
    ) + (f"; was it given in {guess}?" if guess else "; is the size right?")
    if refusal := find_refusal(rig):
        raise CalibrationError(text if units else f"the rig found is impossible: {refusal}")
    if not MIN_DISTANCE_MM < distance < MAX_DISTANCE_MM:
        reporter.warn(text)


def _round(value: float) -> str:
    return f"{value:.4g}"
