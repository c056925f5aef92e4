"""Review of single cameras with the board's shape that an adjustment measured: lens models and own misfits.

In the hierarchy every camera sees the board as drawn. A board that is bent by a fifth of a millimetre then leaves
more than a wrong lens or a missing trigger does, and hides it. A camera without a rig measures the shape by itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult, adjust_bundle
from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.calibration.hierarchy import HierarchyResult, find_unsynchronised_pairs
from beltscape.calibration.intrinsics.lens_choice import AUTO, LensChoice, calibrate_with_model
from beltscape.calibration.intrinsics.sensitivity import NOISE_FLOOR_PX
from beltscape.calibration.intrinsics.zhang import (
    MonocularCalibration,
    calibrate_camera,
    refit_camera,
    set_up_adjustment,
)
from beltscape.calibration.network.association import CameraNetwork, associate_cameras
from beltscape.calibration.network.contradicting_frames import MIN_FRAMES
from beltscape.calibration.network.global_optimisation import optimise_network
from beltscape.calibration.network.pairs import Pair, calibrate_pairs
from beltscape.calibration.solver.lens import compute_lens_prior, list_parameters
from beltscape.calibration.solver.levenberg_marquardt import Damping, minimise, single_thread
from beltscape.core.arrays import Array
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.target.board import Board, corner_points_mm

MAX_ROUNDS = 2
"""Largest number of repeated choices: the shape that a right lens leaves changes a second choice in no set tried."""

TOGETHER_FACTOR, TOGETHER_PX = 1.5, 0.05
"""A camera's noise in the joint adjustment over that of its own views, and the noise itself, px, from which on its
pairs are looked into; synchronous rigs have 1.0 to 1.1 where the board's shape is adjusted."""


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


def refit_own_views(hierarchy: HierarchyResult, adjustment: BundleAdjustmentResult) -> HierarchyResult:
    """Return the hierarchy with each camera refitted to its own views with the board's measured shape.

    Pairs are refitted, too, where one fits worse than its cameras then do alone.
    """
    if not np.any(adjustment.shape_mm):
        return hierarchy
    board_mm, views = adjustment.geometry.points_mm, hierarchy.detections.views
    try:
        with single_thread():
            own = {name: _refit(each, views[name], board_mm) for name, each in hierarchy.monocular.items()}
            again = replace(hierarchy, monocular=own)
            if not find_unsynchronised_pairs(again):
                return again
            pairs = calibrate_pairs(hierarchy.detections, own, board_mm, Silent())
            return replace(again, network=optimise_network(associate_cameras(hierarchy.rig.core, pairs)))
    except (CalibrationError, np.linalg.LinAlgError):  # the first results stand
        return hierarchy


def _refit(
    calibration: MonocularCalibration, views: Mapping[str, Corners], board_mm: Array
) -> MonocularCalibration:
    """Return the calibration of a camera with other board corners; a lens that is given stays as it is."""
    camera = calibration.camera
    if set(calibration.fixed) < set(list_parameters(camera.model)):
        return refit_camera(calibration, views, board_mm)
    used = {frame: views[frame] for frame in calibration.cam_from_board}
    seen = BoardDetections({camera.name: camera.size_px}, {camera.name: used}, {camera.name: len(used)})
    found = calibrate_camera(camera.name, seen, board_mm, known=camera, min_views=1)
    return replace(found, rejected={**calibration.rejected, **found.rejected}, prior=calibration.prior)


def select_suspicious_pairs(hierarchy: HierarchyResult, adjustment: BundleAdjustmentResult) -> list[Pair]:
    """Return the pairs that some frames may contradict.

    Their cameras fit far worse in the joint adjustment than alone, or they or the adjustment rejected whole frames,
    or the pair would be reported as not synchronous: it is not before its frames were looked into.
    """
    unsynchronised = find_unsynchronised_pairs(hierarchy)
    own = np.array([hierarchy.monocular[name].rms_px / np.sqrt(2) for name in adjustment.rig.cameras])
    is_worse = adjustment.sigma_px > np.maximum(TOGETHER_FACTOR * own, TOGETHER_PX)
    worse = {name for name, flag in zip(adjustment.rig.cameras, is_worse, strict=True) if flag}
    used = adjustment.count_used_corners()
    lost = {
        name: {frame for frame in camera.cam_from_board if not used.get((name, frame))}
        for name, camera in hierarchy.monocular.items()
    }
    return [
        pair
        for pair in hierarchy.network.pairs
        if pair.rejected
        or pair in unsynchronised
        or {pair.first, pair.second} & worse
        or len((lost[pair.first] | lost[pair.second]) & set(pair.frames)) >= MIN_FRAMES
    ]


def find_changed(hierarchy: HierarchyResult, choices: dict[str, LensChoice]) -> list[str]:
    """Return the cameras whose lens model differs from the one that they were adjusted with."""
    return [name for name in choices if choices[name].model != hierarchy.rig.cameras[name].model]


MIN_SHAPE_VIEWS = 8
"""Least number of a camera's views that measure the board's shape beside its lens: with eight a bend of 0.2 mm is
found to 0.03 mm, and the lens is five times nearer to the truth."""


@dataclass(frozen=True, slots=True, eq=False)
class ReviewedCamera:
    """A camera calibrated by its own views, with the board's shape where these show one."""

    monocular: MonocularCalibration
    choice: LensChoice
    adjustment: BundleAdjustmentResult | None = None
    """Of the lens, the views and the board's shape; None if the board is flat and regular within their accuracy, or
    they are too few."""


def review_camera(
    detections: BoardDetections, calibration: MonocularCalibration, choice: LensChoice, board: Board
) -> ReviewedCamera:
    """Return a camera calibrated by itself, its lens chosen again with the board's shape that its own views measure.

    A model that was asked for stays.
    """
    name, drawn_mm = choice.camera, corner_points_mm(board)
    found = ReviewedCamera(calibration, choice)
    if len(calibration.cam_from_board) < MIN_SHAPE_VIEWS:
        return found
    own = detections.restrict([name], detections.frames)
    for _ in range(MAX_ROUNDS + 1):
        monocular = found.monocular
        requested = monocular.camera.model if choice.is_requested else AUTO
        with suppress(CalibrationError, np.linalg.LinAlgError):
            adjustment = adjust_bundle(_stand_alone(own, monocular), board)
            shape_mm = adjustment.geometry.points_mm
            if not np.any(adjustment.shape_mm):
                return _return_to_drawing(own, found, board) if found.adjustment else found
            again, chosen = calibrate_with_model(
                name, own, shape_mm, requested, drawn_mm=drawn_mm, start=monocular
            )
            chosen = replace(chosen, is_requested=choice.is_requested)
            found = ReviewedCamera(again, chosen, adjustment)
            if again.camera.model != monocular.camera.model:
                continue
        return found
    return found


def _return_to_drawing(detections: BoardDetections, found: ReviewedCamera, board: Board) -> ReviewedCamera:
    """Return the camera with its second model and the drawn board, which only the first model let look bent."""
    name, model = found.choice.camera, found.choice.model
    monocular, _ = calibrate_with_model(name, detections, corner_points_mm(board), model)
    return ReviewedCamera(monocular, found.choice)


def _stand_alone(detections: BoardDetections, calibration: MonocularCalibration) -> HierarchyResult:
    """Return the hierarchy of a camera without others."""
    name, at = calibration.camera.name, Pose.identity()
    network = CameraNetwork(name, {name: at}, {name: (name,)}, (), (), ())
    rig = Rig(name, {name: calibration.camera}, {name: at})
    return HierarchyResult(rig, detections, {name: calibration}, network)


def set_up_alone(
    detections: BoardDetections, calibration: MonocularCalibration, board_mm: Array
) -> BundleAdjustmentResult:
    """Return the calibration of a camera as an adjustment, at its minimum with the prior of lenses."""
    camera, views = calibration.camera, detections.views[calibration.camera.name]
    used = {frame: views[frame] for frame in calibration.cam_from_board}
    corners = sum(len(view) for view in used.values())
    noise_px = _estimate_noise_px(calibration, corners)
    bundle, start = set_up_adjustment(
        used, camera, list(calibration.cam_from_board.values()), board_mm,
        prior=compute_lens_prior(camera), fixed=calibration.fixed, sigma_px=noise_px,
    )  # fmt: skip
    with suppress(np.linalg.LinAlgError):
        start = minimise(bundle, start, Damping(tolerance=1e-7)).state
    rig = Rig(camera.name, {camera.name: camera}, {camera.name: Pose.identity()})
    used_corners, sigma_px = np.ones(corners, np.bool_), np.array([noise_px])
    return BundleAdjustmentResult(
        rig, bundle, start, tuple(used), used_corners, sigma_px, np.zeros_like(board_mm), ()
    )


def _estimate_noise_px(calibration: MonocularCalibration, corners: int) -> float:
    """Return the noise of a corner's coordinate from the residuals, with the degrees of freedom of lens and poses."""
    fitted = len(list_parameters(calibration.camera.model)) + 6 * len(calibration.cam_from_board)
    freedom = max(2 * corners - fitted, 1)
    return max(calibration.rms_px * float(np.sqrt(corners / freedom)), NOISE_FLOOR_PX)
