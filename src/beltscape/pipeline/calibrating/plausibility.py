"""Plausibility of a calibrated rig: cameras at one place, boards of another unit, halves that disagree."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np

from beltscape.calibration.assessment.validation.cross_validation import CrossValidation
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.calibration.hierarchy import HierarchyResult
from beltscape.core.errors import CalibrationError
from beltscape.core.progress import Reporter
from beltscape.target.board import Board

MAX_SPLIT_RATIO = 2.0
"""Ratio of the halves' depth differences to their standard deviation above which the stated σ are too small."""
MIN_BASELINE = 1e-3
"""Least baseline over the board's distance for which depth can be measured; planned rigs have 0.1 and more."""
MIN_DISTANCE_MM, MAX_DISTANCE_MM = 90.0, 30_000.0
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


def warn_of_distance(board: Board, adjustment: BundleAdjustmentResult, reporter: Reporter) -> None:
    """Warn if the board's size is implausible."""
    distance = float(np.median(adjustment.geometry.board_translation_mm[:, 2]))
    if not MIN_DISTANCE_MM < distance < MAX_DISTANCE_MM:
        factor, unit = (10, "centimetres") if distance < MIN_DISTANCE_MM else (0.001, "micrometres")
        reporter.warn(
            f"with square_mm = {board.square_mm:g} the board was {distance:.3g} mm away; was it given in {unit} "
            f"({board.square_mm * factor:g} mm)?"
        )
