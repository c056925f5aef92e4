"""Calibration of a capture of board views: the rig, its plausibility, its scores and findings.

Implausible are cameras at one place, boards of another unit, and halves of the views that disagree.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from beltscape.calibration.assessment.board_print import describe_print
from beltscape.calibration.assessment.board_size import CertifiedSize, estimate_board_size
from beltscape.calibration.assessment.covariance import (
    DepthSigma,
    RigCovariance,
    add_scale,
    compute_clustered_covariance,
    compute_depth_sigma,
    compute_rig_covariance,
)
from beltscape.calibration.assessment.coverage import (
    Coverage,
    MeasuringVolume,
    assess_coverage,
    describe_gap,
    has_lost_volume,
    list_coverage_findings,
    make_view_volume,
    require_coverage,
)
from beltscape.calibration.assessment.covered_volume import CoveredRig, limit_to_coverage
from beltscape.calibration.assessment.cross_validation import CrossValidation, cross_validate
from beltscape.calibration.assessment.diagnosis import Discards, diagnose
from beltscape.calibration.assessment.fit_quality import FitQuality, assess_fit
from beltscape.calibration.assessment.lens_domain import describe_domains, describe_tilts, limit_domains
from beltscape.calibration.assessment.next_best_view import NextBestView, find_next_best_view
from beltscape.calibration.assessment.remedy import describe_undetermined
from beltscape.calibration.assessment.score import RigErrors, Score, compute_rig_errors, summarise_errors
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult
from beltscape.calibration.hierarchy import HierarchyResult
from beltscape.calibration.intrinsics.lens_choice import AUTO, describe_choices
from beltscape.calibration.network.two_sides import describe_back
from beltscape.calibration.result import Calibration
from beltscape.calibration.solver.levenberg_marquardt import single_thread
from beltscape.core.arrays import Array
from beltscape.core.errors import CalibrationError, InputError
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import RecordingReporter, Reporter
from beltscape.core.quantities import guess_unit_of_board
from beltscape.files.capture import Capture, read_capture
from beltscape.files.paths import AnyPath, as_path
from beltscape.files.rig_limits import find_refusal
from beltscape.kernels import load_on_processor
from beltscape.pipeline.calibrating.board_sets import resolve_board_set
from beltscape.pipeline.calibrating.intrinsics import KnownIntrinsics
from beltscape.pipeline.calibrating.solving import solve_rig
from beltscape.pipeline.calibrating.views import detect_rig_board
from beltscape.target.board import Board, BoardSet, corner_points_mm, list_triples

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


def calibrate(
    folder: AnyPath,
    board: Board,
    core: str | None,
    reporter: Reporter,
    *,
    known: KnownIntrinsics | None = None,
    lens_model: str = AUTO,
    volume: MeasuringVolume | None = None,
) -> Calibration:
    """Calibrate the rig of a capture of board views; the intrinsics of ``known`` cameras are fixed.

    ``lens_model`` is that of all other cameras, or ``auto``: each camera's own views choose it.
    ``volume`` is what the rig is to measure; the core's whole view stands for an unknown one.
    Findings against the fit come first among the warnings.

    Raises
    ------
    UncoveredVolumeError
        When the board never reached a part of the images that the volume needs.
    InputError, CalibrationError
        With one line that names the fault and the fix.
    """
    folder = as_path(folder, "folder")
    reporter = RecordingReporter(reporter)
    capture = _read_capture(folder, core)
    known = known.match_capture(capture, reporter) if known else KnownIntrinsics({})
    detections, variant = detect_rig_board(capture, board, reporter, known=known.cameras)
    known.require_sizes(detections.sizes_px)
    detections, board, start = resolve_board_set(detections, board, known, lens_model)
    solved = solve_rig(detections, board, core, reporter, start, lens_model)
    hierarchy, adjustment = solved.hierarchy, solved.adjustment
    require_baselines(hierarchy, folder)
    covariance = _compute_covariance(hierarchy, adjustment)
    rig_errors, halves = _score_rig(hierarchy, adjustment, board, start, reporter)
    training, held_out = summarise_errors(rig_errors), halves.score if halves else None
    foreign = known.find_foreign(hierarchy, detections, board)
    triples = list_triples(board)
    diagnosis = diagnose(
        solved.own, adjustment, covariance, triples, rig_errors, halves, explained=tuple(foreign)
    )
    fit = assess_fit(held_out or training, rig_errors, triples, [*foreign.values(), *diagnosis.findings])
    limited = limit_lenses(board, adjustment, known.cameras, reporter)
    coverage, covered = _assess_coverage(adjustment, limited, covariance, volume, reporter)
    size = _assess_size(board, adjustment, covariance, training, reporter)
    warnings = _warn_of_findings(diagnosis.discards, fit, reporter)
    rig = _complete_rig(limited, board, adjustment, covariance, size, (held_out, training), fit, covered)
    by_views, sized = _add_size(rig, adjustment, covariance)
    return Calibration(
        capture=capture, board=board, variant=variant, detections=detections,
        hierarchy=replace(hierarchy, network=diagnosis.network), adjustment=adjustment, rig=rig,
        covariance=sized, depth_sigma=_compute_depth_sigmas(rig, adjustment, sized.matrix),
        depth_sigma_by_views=_compute_depth_sigmas(rig, adjustment, by_views),
        next_best_view=_find_next_best_view(adjustment, covariance),
        rig_errors=rig_errors, training=training, held_out=held_out, fit=fit,
        given=tuple(name for name in adjustment.rig.cameras if name in known.cameras),
        warnings=warnings,
        notes=(*_describe_rig(hierarchy, rig, coverage, board), *diagnosis.notes),
        discards=diagnosis.discards, coverage=coverage,
    )  # fmt: skip


def _describe_rig(hierarchy: HierarchyResult, rig: Rig, coverage: Coverage, board: Board) -> tuple[str, ...]:
    """Return notes on the lenses, on gaps in the core's view, and on the two sides of a board."""
    return (*_describe_lenses(hierarchy, rig), *_describe_gaps(coverage), *_describe_sides(board))


def _describe_lenses(hierarchy: HierarchyResult, rig: Rig) -> list[str]:
    """Return notes on the lens models that were compared, how far each lens is known, and tilted sensors."""
    return [*describe_choices(hierarchy.lens_choices), *describe_domains(rig.cameras), *describe_tilts(rig)]


def _describe_gaps(coverage: Coverage) -> list[str]:
    """Return a note on a gap in the core's view, of which an unknown belt may need a part only."""
    return [] if coverage.volume.is_given else list_coverage_findings(coverage)


def _describe_sides(board: Board) -> tuple[str, ...]:
    """Return a note on the place of the print on a board's back, if there is one."""
    return (describe_back(board),) if isinstance(board, BoardSet) and board.is_two_sided else ()


def _compute_covariance(hierarchy: HierarchyResult, adjustment: BundleAdjustmentResult) -> RigCovariance:
    """Return the rig's covariance; raise CalibrationError if the views do not determine it."""
    try:
        return compute_rig_covariance(adjustment)
    except np.linalg.LinAlgError as error:
        raise CalibrationError(describe_undetermined(hierarchy)) from error


def _assess_coverage(
    adjustment: BundleAdjustmentResult,
    limited: Rig,
    covariance: RigCovariance,
    volume: MeasuringVolume | None,
    reporter: Reporter,
) -> tuple[Coverage, CoveredRig | None]:
    """Return the coverage of the volume, and the rig within it where an unknown belt's volume is covered in part.

    Warn of gaps in a given volume, and of the limits; raise UncoveredVolumeError for large gaps in a given one.
    """
    chosen = volume or make_view_volume(limited, adjustment.geometry)
    coverage = assess_coverage(adjustment, limited, covariance.inflation, chosen)
    if not coverage.is_needed.any():
        raise InputError(
            f"{chosen.name}: core camera {limited.core} of the calibrated rig sees nothing of it; give the file of "
            "this rig, and with a plan, the core camera that looks down on the belt as --core"
        )
    if not chosen.is_given and has_lost_volume(coverage):
        covered = limit_to_coverage(adjustment, limited, covariance.inflation, coverage)
        reporter.warn(f"{describe_gap(coverage, coverage.is_unusable)}; {covered.describe()}")
        return covered.coverage, covered
    require_coverage(coverage)
    for line in list_coverage_findings(coverage) if coverage.volume.is_given else ():
        reporter.warn(line)
    return coverage, None


def _assess_size(
    board: Board,
    adjustment: BundleAdjustmentResult,
    covariance: RigCovariance,
    training: Score,
    reporter: Reporter,
) -> CertifiedSize:
    """Return the board's size; warn of lengths that contradict each other or it, and where none was measured."""
    size = estimate_board_size(board, adjustment, covariance.inflation)
    if isinstance(board, BoardSet) or board.axis_sigma is None:
        for line in describe_print(board, adjustment, covariance.inflation):
            reporter.warn(line)
    if size.contradiction:
        reporter.warn(size.contradiction)
    if not training.has_squares:
        reporter.warn(
            "no two cameras see the same corner at one instant, so that no length was measured and the rig is scored "
            "in px only: cameras that look at different sides of the board measure no common surface"
        )
    return size


def _warn_of_findings(discards: Discards, fit: FitQuality, reporter: RecordingReporter) -> tuple[str, ...]:
    """Warn of frames left out and of the findings against the fit; return all warnings, those of the fit first."""
    for line in discards.frames.values():
        reporter.warn(line)
    others = [line for line in reporter.warnings if line not in fit.findings]
    for line in fit.findings:
        reporter.warn(line)
    return (*fit.findings, *others)


def _read_capture(folder: Path, core: str | None) -> Capture:
    """Read a capture; raise InputError unless it has two cameras, and the core camera if one is given."""
    capture = read_capture(folder)
    if len(capture.cameras) < 2:
        raise InputError(
            f"{folder}: only camera {', '.join(capture.cameras)} has images{capture.explain(*capture.omissions)}; "
            "a rig needs two: give the folder above the camera folders"
        )
    if core is not None and core not in capture.cameras:
        raise InputError(
            f"{folder}: no camera {core or repr(core)} in it; it has {', '.join(capture.cameras)}"
        )
    return capture


def _score_rig(
    hierarchy: HierarchyResult,
    adjustment: BundleAdjustmentResult,
    board: Board,
    known: KnownIntrinsics,
    reporter: Reporter,
) -> tuple[RigErrors, CrossValidation | None]:
    """Return the rig's errors on its own views, and the cross-validation of two halves of them; warn of both."""
    kernels, detections = load_on_processor(), hierarchy.detections
    rig_errors = compute_rig_errors(
        adjustment.rig, detections, board, kernels, corners_mm=adjustment.geometry.points_mm
    )
    reporter.step("scoring on held-out views", 0, 1)
    halves = cross_validate(
        detections, board, hierarchy.rig.core, kernels, known=known.cameras, priors=known.priors,
        lens_models={name: camera.model for name, camera in hierarchy.rig.cameras.items()},
    )  # fmt: skip
    reporter.step("scoring on held-out views", 1, 1)
    warn_of_split(halves, reporter)
    return rig_errors, halves


def _complete_rig(
    rig: Rig,
    board: Board,
    adjustment: BundleAdjustmentResult,
    covariance: RigCovariance,
    size: CertifiedSize,
    scores: tuple[Score | None, Score],
    fit: FitQuality,
    covered: CoveredRig | None,
) -> Rig:
    """Return the rig with its covariance, its quality and the board's shape, which `check` needs.

    ``scores`` are those of views held out, if there are enough, and in training.
    ``covered`` is the rig within the volume that the board covered, where it is limited to that.
    """
    rig = size.resize(covered.rig if covered else rig)
    held_out, training = scores
    shaped = bool(np.any(adjustment.geometry.points_mm != corner_points_mm(board)))
    quality = {
        "held_out": held_out.document() if held_out else None,
        "training": training.document(),
        "fit": {"sound": fit.is_sound, "doubts": fit.findings},
        "sigma_inflation": covariance.inflation,
        "board": board.model_dump(),
        "board_corners_mm": size.factor * adjustment.geometry.points_mm if shaped else None,
    }
    if covered:
        quality["covered"] = {"share_of_view": covered.share, "limits_px": dict(covered.limits_px)}
    if size.sigma:
        quality["scale_sigma"] = size.sigma
    sized = add_scale(rig, covariance.matrix, size.sigma)
    matrix = {"parameters": covariance.parameters, "matrix": sized}
    return replace(rig, quality=quality, covariance=matrix)


def _find_next_best_view(
    adjustment: BundleAdjustmentResult, covariance: RigCovariance
) -> NextBestView | None:
    with single_thread():
        return find_next_best_view(adjustment, covariance)


def _add_size(
    rig: Rig, adjustment: BundleAdjustmentResult, covariance: RigCovariance
) -> tuple[Array, RigCovariance]:
    """Return the covariances by clusters of views (G, G) and of the model with that of the board's size."""
    by_views = add_scale(rig, compute_clustered_covariance(adjustment), rig.scale_sigma)
    return by_views, replace(covariance, matrix=add_scale(rig, covariance.matrix, rig.scale_sigma))


def _compute_depth_sigmas(
    rig: Rig, adjustment: BundleAdjustmentResult, covariance: Array
) -> tuple[DepthSigma, ...]:
    geometry = adjustment.geometry
    depths = (geometry.board_rotation @ geometry.points_mm.T)[:, 2] + geometry.board_translation_mm[:, 2:]
    return tuple(
        compute_depth_sigma(rig, covariance, float(d)) for d in np.quantile(depths, [0.05, 0.5, 0.95])
    )
