"""Cross-validation: the score of rigs from some of the frames on the others.

The folds have no leaks: near-identical board poses are in one fold.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from beltscape.calibration.assessment.covariance import (
    compute_depth_jacobian,
    compute_rig_covariance,
    make_view_points,
)
from beltscape.calibration.assessment.score import RigErrors, Score, compute_rig_errors, summarise_errors
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult, adjust_bundle
from beltscape.calibration.detection.board_poses import cluster_frames
from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.calibration.intrinsics.zhang import MIN_VIEWS
from beltscape.calibration.solver.lens import LensPrior
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.progress import Silent
from beltscape.kernels import Kernels
from beltscape.target.board import Board

MAX_FOLDS = 5
"""More folds need more time and change the score little."""


def list_folds(detections: BoardDetections, frames: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], ...]]:
    """Yield divisions of the frames into disjoint folds, each to be scored by a rig from the others, best first.

    Two folds, of every other pose, are the rule: their rigs share no view, which tests σ as well. If half of the
    poses do not determine a rig, as many folds as poses follow, five at most. Too few poses give no division.
    """
    clusters = cluster_frames(detections, frames)
    counts = [2] * (len(clusters) >= 2 * MIN_VIEWS) + [min(len(clusters), MAX_FOLDS)] * (
        len(clusters) > MIN_VIEWS
    )
    for count in counts:
        members = [{frame for cluster in clusters[i::count] for frame in cluster} for i in range(count)]
        yield tuple(tuple(frame for frame in frames if frame in fold) for fold in members)


@dataclass(frozen=True, slots=True, eq=False)
class CrossValidation:
    """Result of the cross-validation."""

    score: Score
    """Score of each fold of the views under the rig of the others."""
    split_ratio: float
    """RMS difference of depths under the two rigs over their standard deviation; 1 if the covariances are right.

    NaN unless there are two folds.
    """


def cross_validate(
    detections: BoardDetections,
    board: Board,
    core: str,
    kernels: Kernels,
    *,
    known: Mapping[str, Camera] | None = None,
    priors: Mapping[str, LensPrior] | None = None,
    lens_models: Mapping[str, str] | None = None,
) -> CrossValidation | None:
    """Score each fold of the frames under the rig of all others; return None if these are too few.

    Frames of one pose of the board are in one fold (`list_folds`).
    """

    def solve(views: BoardDetections) -> BundleAdjustmentResult:
        hierarchy = solve_hierarchy(
            views, board, core, Silent(), known=known, priors=priors, lens_models=lens_models, is_start=True
        )
        return adjust_bundle(hierarchy, board)

    frames = tuple(frame for frame in detections.frames if _count_cameras(detections, frame) > 1)
    for folds in list_folds(detections, frames):
        with suppress(CalibrationError, np.linalg.LinAlgError):  # too few views for a rig
            return _score_folds(folds, detections.restrict(detections.cameras, frames), board, kernels, solve)
    return None


def _score_folds(
    folds: Sequence[Sequence[str]],
    detections: BoardDetections,
    board: Board,
    kernels: Kernels,
    solve: Callable[[BoardDetections], BundleAdjustmentResult],
) -> CrossValidation:
    rigs: list[BundleAdjustmentResult] = []
    rig_errors: list[RigErrors] = []
    for test in folds:
        train = (frame for frame in detections.frames if frame not in test)
        rigs.append(solve(detections.restrict(detections.cameras, train)))
        views, corners_mm = detections.restrict(detections.cameras, test), rigs[-1].geometry.points_mm
        rig_errors.append(compute_rig_errors(rigs[-1].rig, views, board, kernels, corners_mm=corners_mm))
    ratio = _compute_split_ratio(rigs[0], rigs[1], kernels) if len(rigs) == 2 else float("nan")
    return CrossValidation(summarise_errors(*rig_errors), ratio)


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
