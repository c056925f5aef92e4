"""Solution of a rig from its views: hierarchy and joint adjustment, repeated where they show another lens."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from beltscape.calibration.assessment.remedy import describe_undetermined
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult, adjust_bundle
from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.hierarchy import HierarchyResult, solve_hierarchy
from beltscape.calibration.lens_review import (
    MAX_ROUNDS,
    find_changed,
    refit_own_views,
    review_lenses,
    select_suspicious_pairs,
)
from beltscape.calibration.network.contradicting_frames import find_contradicting_frames, leave_out_frames
from beltscape.core.errors import CalibrationError
from beltscape.core.progress import Reporter, Silent
from beltscape.pipeline.calibrating.intrinsics import KnownIntrinsics
from beltscape.target.board import Board


@dataclass(frozen=True, slots=True, eq=False)
class SolvedRig:
    """A rig as its views give it."""

    hierarchy: HierarchyResult
    adjustment: BundleAdjustmentResult
    own: HierarchyResult
    """The hierarchy with each camera fitted to its own views with the board's measured shape."""


def solve_rig(
    detections: BoardDetections,
    board: Board,
    core: str | None,
    reporter: Reporter,
    start: KnownIntrinsics,
    lens_model: str,
) -> SolvedRig:
    """Return the hierarchy and the joint adjustment of the views, with the lens models that fit the measured board.

    Frames that contradict the others, as without a common instant, are left out by name.

    Raises
    ------
    CalibrationError
        With one line that names the fault and the fix.
    """
    models = dict.fromkeys(detections.cameras, lens_model)
    hierarchy = _solve_views(detections, board, core, reporter, start, models)
    adjustment = _adjust_views(hierarchy, board, reporter)
    for _ in range(MAX_ROUNDS):
        choices = review_lenses(hierarchy, adjustment, board)
        hierarchy = replace(
            hierarchy,
            lens_choices=tuple(choices.get(each.camera, each) for each in hierarchy.lens_choices),
        )
        if not find_changed(hierarchy, choices):
            break
        own = hierarchy.detections.restrict(hierarchy.rig.cameras, hierarchy.detections.frames)
        models = {name: choices[name].model if name in choices else models[name] for name in own.cameras}
        again = _solve_views(own, board, hierarchy.rig.core, Silent(), start, models)
        hierarchy = replace(again, lens_choices=hierarchy.lens_choices)
        adjustment = _adjust_views(hierarchy, board, reporter)
    return _leave_out_contradicting_frames(hierarchy, adjustment, board, start, reporter)


def _leave_out_contradicting_frames(
    hierarchy: HierarchyResult,
    adjustment: BundleAdjustmentResult,
    board: Board,
    start: KnownIntrinsics,
    reporter: Reporter,
) -> SolvedRig:
    """Return the solution without the frames that contradict the others; the same one if there are none."""
    own = refit_own_views(hierarchy, adjustment)
    contradicting = find_contradicting_frames(
        own.detections, own.monocular, select_suspicious_pairs(own, adjustment), adjustment.geometry.points_mm
    )
    if not contradicting:
        return SolvedRig(hierarchy, adjustment, own)
    kept = leave_out_frames(hierarchy.detections, contradicting)
    models = {name: camera.model for name, camera in hierarchy.rig.cameras.items()}
    again = _solve_views(kept, board, hierarchy.rig.core, Silent(), start, models)
    again = replace(again, lens_choices=hierarchy.lens_choices, contradicting_frames=contradicting)
    adjustment = _adjust_views(again, board, reporter)
    return SolvedRig(again, adjustment, refit_own_views(again, adjustment))


def _solve_views(
    detections: BoardDetections,
    board: Board,
    core: str | None,
    reporter: Reporter,
    start: KnownIntrinsics,
    models: Mapping[str, str],
) -> HierarchyResult:
    return solve_hierarchy(
        detections, board, core, reporter, known=start.cameras, priors=start.priors, lens_models=models
    )


def _adjust_views(hierarchy: HierarchyResult, board: Board, reporter: Reporter) -> BundleAdjustmentResult:
    """Return the bundle adjustment of all views."""
    reporter.step("adjusting everything together", 0, 1)
    try:
        adjustment = adjust_bundle(hierarchy, board)
    except np.linalg.LinAlgError as error:
        raise CalibrationError(describe_undetermined(hierarchy)) from error
    reporter.step("adjusting everything together", 1, 1)
    return adjustment
