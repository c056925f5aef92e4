"""Cameras added to a calibrated rig, or calibrated anew in it; all others keep their intrinsics and poses.

The covariance of the whole is that of the former rig, and that of the new cameras given it.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.calibration.assessment.covariance import (
    POSE_NAMES,
    compute_rig_covariance,
    differentiate_by_scale,
)
from beltscape.calibration.assessment.cross_validation import list_folds
from beltscape.calibration.assessment.findings import list_rig_findings
from beltscape.calibration.assessment.fit_quality import FitQuality, assess_fit
from beltscape.calibration.assessment.lens_domain import describe_domains, limit_domains
from beltscape.calibration.assessment.score import RigErrors, Score, compute_rig_errors, summarise_errors
from beltscape.calibration.bundle_adjustment import BundleAdjustmentResult, adjust_bundle
from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.hierarchy import HierarchyResult
from beltscape.calibration.intrinsics.lens_choice import AUTO, calibrate_with_model
from beltscape.calibration.intrinsics.zhang import calibrate_camera
from beltscape.calibration.network.association import associate_cameras, find_groups
from beltscape.calibration.network.board_symmetry import unify_numbering
from beltscape.calibration.network.pairs import calibrate_pairs
from beltscape.calibration.solver.levenberg_marquardt import single_thread
from beltscape.core.arrays import Array
from beltscape.core.errors import CalibrationError, InputError
from beltscape.core.geometry.lens import list_intrinsics
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import RecordingReporter, Reporter, Silent
from beltscape.files.capture import Capture, read_capture
from beltscape.files.paths import AnyPath, as_path
from beltscape.files.rig_json import write_rig
from beltscape.kernels import load_on_processor
from beltscape.pipeline.calibrating.calibration import check_scale
from beltscape.pipeline.calibrating.intrinsics import KnownIntrinsics
from beltscape.pipeline.calibrating.views import detect_rig_board
from beltscape.target.board import Board, corner_points_mm, list_triples


def join_covariances(
    rig: Rig,
    joined: Rig,
    adjustment: BundleAdjustmentResult,
    new: tuple[str, ...],
    reference_from_core: Pose,
) -> dict[str, object]:
    """Return the covariance of all cameras; that of the new ones holds for the others as they are."""
    names = [
        f"{name}.{parameter}"
        for name, camera in joined.cameras.items()
        for parameter in list_intrinsics(camera.model)
    ]
    names += [f"{name}.{p}" for name in joined.cameras if name != joined.core for p in POSE_NAMES]
    matrix = np.zeros((len(names), len(names)))
    own = compute_rig_covariance(adjustment)
    former = [each for each in rig.covariance.get("parameters", ()) if each.split(".")[0] not in new]
    _copy_block(
        matrix, names, list(rig.covariance.get("parameters", ())), rig.covariance.get("matrix", ()), former
    )
    is_new = [each for each in own.parameters if each.rsplit(".", 1)[0] in new]
    _copy_block(matrix, names, list(own.parameters), own.matrix, is_new)
    for name in new:
        # a turn about the camera's own axes also moves the core's origin, which lies off the reference's
        lever = adjustment.rig.cam_from_core[name].rotation @ reference_from_core.translation_mm
        place = [names.index(f"{name}.{p}") for p in POSE_NAMES]
        jacobian = np.eye(len(names))
        jacobian[np.ix_(place[3:], place[:3])] = -_skew(lever)
        matrix = jacobian @ matrix @ jacobian.T
    # all poses scale alike with the board that the former rig was calibrated with
    by_scale = differentiate_by_scale(joined)
    kept = np.array([each in former for each in names])
    by_former = np.where(kept, by_scale, 0.0)
    matrix += rig.scale_sigma**2 * (np.outer(by_scale, by_scale) - np.outer(by_former, by_former))
    return {"parameters": names, "matrix": matrix}


def _copy_block(
    matrix: Array, names: list[str], source_names: list[str], source: object, chosen: list[str]
) -> None:
    """Copy the rows and columns of some parameters."""
    if not chosen:
        return
    to, at = [names.index(each) for each in chosen], [source_names.index(each) for each in chosen]
    matrix[np.ix_(to, to)] = np.asarray(source, np.float64)[np.ix_(at, at)]


def _skew(v: Array) -> Array:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


@dataclass(frozen=True, slots=True, eq=False)
class RigExtension:
    """A rig with cameras added or replaced."""

    rig: Rig
    """All cameras; its covariance is the former rig's, with that of the new cameras given the others."""
    new: tuple[str, ...]
    fixed: tuple[str, ...]
    """Cameras of the former rig that the capture holds."""
    training: Score
    held_out: Score | None
    """Score of folds of the frames under the new cameras from the other folds; None with too few frames."""
    fit: FitQuality
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    """New cameras whose lens is known in a part of the image only, one line each."""


def extend_rig(
    folder: AnyPath,
    rig: Rig,
    board: Board,
    reporter: Reporter,
    *,
    replaced: tuple[str, ...] = (),
    known: KnownIntrinsics | None = None,
    lens_model: str = AUTO,
) -> RigExtension:
    """Calibrate the cameras of a capture that a rig lacks, and the ``replaced`` ones, with all others held.

    ``lens_model`` is that of the new cameras without ``known`` intrinsics, or ``auto``: their views choose it.

    Raises
    ------
    InputError, CalibrationError
        With one line that names the fault and the fix.
    """
    folder = as_path(folder, "folder")
    reporter = RecordingReporter(reporter)
    capture = read_capture(folder)
    new, fixed = _select_cameras(capture, rig, replaced)
    known = known.match_capture(capture.select_cameras(new), reporter) if known else KnownIntrinsics({})
    held_cameras = {name: rig.cameras[name] for name in fixed}
    detections, _ = detect_rig_board(
        capture.select_cameras((*fixed, *new)), board, reporter, known={**held_cameras, **known.cameras}
    )
    KnownIntrinsics(held_cameras, "the rig").require_sizes(detections.sizes_px)
    known.require_sizes(detections.sizes_px)
    reference = max(fixed, key=lambda name: len(detections.views.get(name, {})))
    kept = _refer_to(rig, fixed, reference)
    adjustment = _adjust_new_cameras(
        detections, kept, new, known, board, reporter, dict.fromkeys(new, lens_model)
    )
    limited = limit_domains(adjustment.rig, adjustment, (*fixed, *known.cameras))
    extended = _join(rig, replace(adjustment, rig=limited), new, reference)
    check_scale(board, adjustment, extended, reporter)
    kernels, board_mm = load_on_processor(), adjustment.geometry.points_mm
    rig_errors = compute_rig_errors(extended, detections, board, kernels, corners_mm=board_mm)
    training = summarise_errors(rig_errors)
    held_out = _score_held_out(
        detections, kept, new, known, board, {name: extended.cameras[name].model for name in new}
    )
    findings = list_rig_findings(extended, detections, board, board_mm, rig_errors)
    fit = assess_fit(held_out or training, rig_errors, list_triples(board), findings)
    others = [line for line in reporter.warnings if line not in fit.findings]
    for line in fit.findings:
        reporter.warn(line)
    added = {"cameras": new, "score": (held_out or training).document()}
    return RigExtension(
        replace(extended, quality={**extended.quality, "extension": added}),
        new,
        fixed,
        training,
        held_out,
        fit,
        (*fit.findings, *others),
        tuple(describe_domains({name: extended.cameras[name] for name in new})),
    )


def _select_cameras(
    capture: Capture, rig: Rig, replaced: tuple[str, ...]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the cameras to calibrate and those to hold; InputError if there are none, or a name is wrong."""
    for name in replaced:
        if name not in rig.cameras:
            raise InputError(f"--replace {name}: the rig has the cameras {', '.join(rig.cameras)}")
        if name == rig.core:
            raise InputError(
                f"--replace {name}: it is the core camera, which all poses refer to; calibrate anew"
            )
        if name not in capture.cameras:
            raise InputError(f"{capture.folder / name}: no images of the camera to replace")
    new = tuple(name for name in capture.cameras if name not in rig.cameras or name in replaced)
    fixed = tuple(name for name in capture.cameras if name not in new)
    if not new:
        raise InputError(
            f"{capture.folder}: the rig has all its cameras ({', '.join(fixed)}); give views of another camera, or "
            "name those to calibrate anew with --replace"
        )
    if not fixed:
        raise InputError(
            f"{capture.folder}: has the cameras {', '.join(new)}, the rig {', '.join(rig.cameras)}; at least one "
            "camera that keeps its pose must see the board as well"
        )
    return new, fixed


def _refer_to(rig: Rig, fixed: tuple[str, ...], reference: str) -> Rig:
    """Return the held cameras relative to one of them, which the capture holds; the core may be absent from it."""
    from_reference = rig.cam_from_core[reference].inverse()
    order = (reference, *(name for name in fixed if name != reference))
    return Rig(
        core=reference,
        cameras={name: rig.cameras[name] for name in order},
        cam_from_core={name: rig.cam_from_core[name] @ from_reference for name in order[1:]}
        | {reference: Pose.identity()},
    )


def _adjust_new_cameras(
    detections: BoardDetections,
    kept: Rig,
    new: tuple[str, ...],
    known: KnownIntrinsics,
    board: Board,
    reporter: Reporter,
    lens_models: Mapping[str, str],
) -> BundleAdjustmentResult:
    """Adjust the new cameras with all others held; CalibrationError naming the camera that cannot be connected."""
    board_mm, given = corner_points_mm(board), {**kept.cameras, **known.cameras}
    with single_thread():
        monocular = {
            name: (
                calibrate_camera(name, detections, board_mm, known=given[name], min_views=1)
                if name in given
                else calibrate_with_model(name, detections, board_mm, lens_models.get(name, AUTO))[0]
            )
            for name in (*kept.cameras, *new)
            if name in new or detections.views[name]
        }
        for name, prior in known.priors.items():
            monocular[name] = replace(monocular[name], fixed=prior.fixed, prior=prior)
        numbering = unify_numbering(detections, monocular, board)
        detections, monocular = numbering.detections, dict(numbering.monocular)
        pairs = calibrate_pairs(detections, monocular, board_mm, reporter)
        groups = find_groups(monocular, pairs)
        for name in new:
            if not any(name in group and kept.core in group for group in groups):
                raise CalibrationError(
                    f"camera {name}: shares no view of the board with {', '.join(kept.cameras)}, which keep their "
                    "poses; show the board to it and to one of them in the same frame"
                )
        network = associate_cameras(kept.core, pairs)
    order = [*(name for name in kept.cameras if name in monocular), *new]
    start = Rig(
        core=kept.core,
        cameras={name: monocular[name].camera for name in order},
        cam_from_core={
            name: (kept if name in kept.cameras else network).cam_from_core[name] for name in order
        },
    )
    detections = detections.restrict(order, detections.frames)
    hierarchy = HierarchyResult(
        start,
        detections,
        {name: monocular[name] for name in order},
        network,
        fixed_poses=frozenset(kept.cameras),
    )
    return adjust_bundle(hierarchy, board)


def _join(rig: Rig, adjustment: BundleAdjustmentResult, new: tuple[str, ...], reference: str) -> Rig:
    """Return the rig with the new cameras relative to its core, and its covariance with theirs."""
    reference_from_core = rig.cam_from_core[reference]
    cameras = {**rig.cameras, **{name: adjustment.rig.cameras[name] for name in new}}
    poses = {
        **rig.cam_from_core,
        **{name: adjustment.rig.cam_from_core[name] @ reference_from_core for name in new},
    }
    joined = Rig(rig.core, cameras, poses, quality=rig.quality)
    return replace(joined, covariance=join_covariances(rig, joined, adjustment, new, reference_from_core))


def _score_held_out(
    detections: BoardDetections,
    kept: Rig,
    new: tuple[str, ...],
    known: KnownIntrinsics,
    board: Board,
    lens_models: Mapping[str, str],
) -> Score | None:
    """Score each fold of the frames that new and fixed cameras share under the rig of the other folds."""
    shared = tuple(
        frame
        for frame in detections.frames
        if any(frame in detections.views[name] for name in new)
        and any(frame in detections.views[name] for name in kept.cameras)
    )
    for folds in list_folds(detections, shared):
        with suppress(CalibrationError):
            errors: list[RigErrors] = []
            for fold in folds:
                train = detections.restrict(detections.cameras, set(detections.frames) - set(fold))
                adjusted = _adjust_new_cameras(train, kept, new, known, board, Silent(), lens_models)
                test = detections.restrict(tuple(adjusted.rig.cameras), fold)
                errors.append(
                    compute_rig_errors(
                        adjusted.rig, test, board, load_on_processor(), corners_mm=adjusted.geometry.points_mm
                    )
                )
            return summarise_errors(*errors)
    return None


def make_extension_document(extension: RigExtension) -> Mapping[str, Any]:
    """Return the result as plain values for JSON."""
    return {
        "new": extension.new,
        "held": extension.fixed,
        "held_out": extension.held_out.document() if extension.held_out else None,
        "training": extension.training.document(),
        "fit": extension.fit.document(),
        "notes": extension.notes,
    }


def write_extension(out: Path, extension: RigExtension) -> Path:
    """Write rig.json into a folder; return its path."""
    write_rig(out / "rig.json", extension.rig)
    return out / "rig.json"
