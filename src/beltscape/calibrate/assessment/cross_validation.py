"""Cross-validation: the score of rigs from half of the frames on the other half."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from beltscape.calibrate.assessment.covariance import (
    compute_depth_jacobian,
    compute_rig_covariance,
    make_view_points,
)
from beltscape.calibrate.assessment.score import Score, compute_rig_errors, summarise_errors
from beltscape.calibrate.bundle_adjustment import BundleAdjustmentResult, adjust_bundle
from beltscape.calibrate.detection.corners import BoardDetections
from beltscape.calibrate.hierarchy import solve_hierarchy
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.progress import Silent
from beltscape.kernels import Kernels
from beltscape.target.board import Board


@dataclass(frozen=True, slots=True, eq=False)
class CrossValidation:
    """Result of the cross-validation of two halves of the views."""

    score: Score
    """Score of each half under the rig of the other half."""
    split_ratio: float
    """RMS difference of depths under the two rigs over their standard deviation; 1 if the covariances are right."""


def cross_validate(
    detections: BoardDetections,
    board: Board,
    core: str,
    kernels: Kernels,
    *,
    known: Mapping[str, Camera] | None = None,
) -> CrossValidation | None:
    """Score even frames under the rig of the odd ones and vice versa; return None if half the frames are too few."""
    frames = [frame for frame in detections.frames if _count_cameras(detections, frame) > 1]
    halves = frames[::2], frames[1::2]
    try:
        first, second = (
            _calibrate_rig(detections.restrict(detections.cameras, train), board, core, known)
            for train in halves
        )
        rig_errors = [
            compute_rig_errors(
                trained.rig,
                detections.restrict(detections.cameras, test),
                board,
                kernels,
                corners_mm=trained.geometry.points_mm,
            )
            for trained, test in zip((first, second), halves[::-1], strict=True)
        ]
    except CalibrationError:
        return None
    return CrossValidation(summarise_errors(*rig_errors), _compute_split_ratio(first, second, kernels))


def _calibrate_rig(
    detections: BoardDetections, board: Board, core: str, known: Mapping[str, Camera] | None
) -> BundleAdjustmentResult:
    return adjust_bundle(solve_hierarchy(detections, board, core, Silent(), known=known), board)


def _compute_split_ratio(
    first: BundleAdjustmentResult, second: BundleAdjustmentResult, kernels: Kernels
) -> float:
    """Return `CrossValidation.split_ratio`; NaN if the two rigs have no common view."""
    names = list(first.rig.cameras)
    if names != list(second.rig.cameras):
        return float("nan")
    distance = float(np.median(first.geometry.board_translation_mm[:, 2]))
    points = make_view_points(first.rig, distance, 13)
    pixels = np.stack([first.rig.project_into(second.rig, name, points) for name in names])
    measured = kernels.triangulate(np.stack([second.rig.projection(name) for name in names]), pixels)
    expected = sum(
        np.einsum("ni,ij,nj->n", jacobian, compute_rig_covariance(each).matrix, jacobian)
        for each, jacobian in ((each, compute_depth_jacobian(each.rig, points)) for each in (first, second))
    )
    ratios = (measured[:, 2] - distance) ** 2 / expected
    return float(np.sqrt(np.nanmean(ratios))) if np.isfinite(ratios).any() else float("nan")


def _count_cameras(detections: BoardDetections, frame: str) -> int:
    return sum(frame in views for views in detections.views.values())
