"""Capture and board → rig, scores and report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.calibrate.adjust import Adjusted, adjust
from beltscape.calibrate.chain import Chain, solve
from beltscape.calibrate.corners import Sightings
from beltscape.calibrate.detect import Variant
from beltscape.calibrate.fit_doubts import calibration_doubts
from beltscape.calibrate.fit_quality import FitQuality, assess_fit, camera_fits
from beltscape.calibrate.guidance import NextPose, next_pose
from beltscape.calibrate.heldout import HeldOut, held_out_score
from beltscape.calibrate.score import Evidence, Score, examine, score
from beltscape.calibrate.sightings import find_board
from beltscape.calibrate.uncertainty import DepthSigma, RigCovariance, depth_sigma, rig_covariance
from beltscape.core.errors import CalibrationError, InputError
from beltscape.core.progress import RecordingReporter, Reporter
from beltscape.core.rig import Rig
from beltscape.files.capture import Capture, read_capture
from beltscape.files.paths import AnyPath, as_path
from beltscape.kernels import load
from beltscape.pipeline.known_intrinsics import KnownIntrinsics
from beltscape.target.board import Board

SPLIT_LIMIT = 2.0
"""Halves of the views may differ so much more than their covariances say."""
LEAST_BASELINE = 1e-3
"""Cameras less than this share of the board's distance apart measure no depth: a planned rig has 0.1 and more."""
NEAREST_MM, FARTHEST_MM = 90.0, 30_000.0
"""A board outside these distances was hardly meant."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Everything that calibrating a capture gave."""

    capture: Capture
    board: Board
    variant: Variant
    sightings: Sightings
    chain: Chain
    adjusted: Adjusted
    rig: Rig
    """The final rig, with its scores and its covariance."""
    covariance: RigCovariance
    depth_sigma: tuple[DepthSigma, ...]
    """What the calibration does to depths at the nearest, middle and farthest boards."""
    next_pose: NextPose | None
    """The most useful further view."""
    evidence: Evidence
    training: Score
    """On the very views the rig was found from: it flatters."""
    held_out: Score | None
    """On views the rig was not found from: the headline. None where half of the views is too little."""
    fit: FitQuality
    """The fit, judged by its own figures."""
    given: tuple[str, ...]
    """Cameras whose intrinsics were given."""
    warnings: tuple[str, ...]


def calibrate(
    folder: AnyPath,
    board: Board,
    core: str | None,
    reporter: Reporter,
    *,
    known: KnownIntrinsics | None = None,
) -> Calibration:
    """Calibrate the rig of a capture of board views; the intrinsics of ``known`` cameras are held as they are.

    What speaks against the fit comes first among the warnings.

    Raises
    ------
    InputError, CalibrationError
        With one line that names what is wrong and the mend.
    """
    folder = as_path(folder, "folder")
    reporter = RecordingReporter(reporter)
    capture = read_capture(folder)
    if len(capture.cameras) < 2:
        raise InputError(
            f"{folder}: only camera {', '.join(capture.cameras)} has images; a rig needs two: "
            "give the folder above the camera folders"
        )
    if core is not None and core not in capture.cameras:
        raise InputError(
            f"{folder}: no camera {core or repr(core)} in it; it has {', '.join(capture.cameras)}"
        )
    known = known.matched(capture, reporter) if known else KnownIntrinsics({})
    sightings, variant = find_board(capture, board, reporter)
    known.require_sizes(sightings.sizes_px)
    chain = solve(sightings, board, core, reporter, known=known.cameras)
    _require_baselines(chain, folder)
    kernels = load()
    own = chain.sightings
    reporter.step("adjusting everything together", 0, 1)
    adjusted = adjust(chain, board)
    covariance = rig_covariance(adjusted)
    reporter.step("adjusting everything together", 1, 1)
    evidence = examine(adjusted.rig, own, board, kernels, corners_mm=adjusted.geometry.points_mm)
    reporter.step("scoring on held-out views", 0, 1)
    halves = held_out_score(own, board, chain.rig.core, kernels, known=known.cameras)
    held_out = halves.score if halves else None
    reporter.step("scoring on held-out views", 1, 1)
    _warn_of_distance(board, adjusted, reporter)
    _warn_of_split(halves, reporter)
    training = score(evidence)
    fits = camera_fits(evidence, board.grid)
    foreign = known.foreign(chain, sightings, board)
    doubts = [*foreign.values(), *calibration_doubts(chain, fits, halves, training, explained=tuple(foreign))]
    fit = assess_fit(held_out or training, evidence, board.grid, doubts)
    others = [line for line in reporter.warnings if line not in fit.doubts]
    for line in fit.doubts:
        reporter.warn(line)
    rig = replace(
        adjusted.rig,
        quality=_quality(board, adjusted, covariance, held_out, training, fit),
        covariance={"parameters": covariance.parameters, "matrix": covariance.matrix},
    )
    return Calibration(
        capture=capture,
        board=board,
        variant=variant,
        sightings=sightings,
        chain=chain,
        adjusted=adjusted,
        rig=rig,
        covariance=covariance,
        depth_sigma=_depth_sigmas(rig, adjusted, covariance),
        next_pose=next_pose(adjusted, covariance),
        evidence=evidence,
        training=training,
        held_out=held_out,
        fit=fit,
        given=tuple(name for name in adjusted.rig.cameras if name in known.cameras),
        warnings=(*fit.doubts, *others),
    )


def _require_baselines(chain: Chain, folder: Path) -> None:
    """Raise CalibrationError where two cameras stand at the same place: no depth can be measured with them."""
    centers = {name: pose.center_mm for name, pose in chain.rig.cam_from_core.items()}
    boards = [
        pose.translation_mm[2]
        for camera in chain.monocular.values()
        for pose in camera.cam_from_board.values()
    ]
    for first, second in combinations(centers, 2):
        baseline = float(np.linalg.norm(centers[first] - centers[second]))
        if baseline < LEAST_BASELINE * float(np.median(boards)):
            raise CalibrationError(
                f"{folder}: cameras {first} and {second} stand at the same place ({baseline:.2g} mm apart); are the "
                f"images of one a copy of the other's? Give each camera its own"
            )


def _warn_of_split(halves: HeldOut | None, reporter: Reporter) -> None:
    """State it where the standard deviations are too small."""
    if halves is not None and halves.split_ratio > SPLIT_LIMIT:
        reporter.warn(
            f"the rigs of even and odd frames differ {halves.split_ratio:.1f} times more than their standard "
            "deviations allow: the stated σ are too small; look for moving cameras, blur or a bending board"
        )


def _warn_of_distance(board: Board, adjusted: Adjusted, reporter: Reporter) -> None:
    """State it where the board's size is not believable."""
    distance = float(np.median(adjusted.geometry.board_translation_mm[:, 2]))
    if not NEAREST_MM < distance < FARTHEST_MM:
        factor, unit = (10, "centimetres") if distance < NEAREST_MM else (0.001, "micrometres")
        reporter.warn(
            f"with square_mm = {board.square_mm:g} the board was {distance:.3g} mm away; was it given in {unit} "
            f"({board.square_mm * factor:g} mm)?"
        )


def _quality(
    board: Board,
    adjusted: Adjusted,
    covariance: RigCovariance,
    held_out: Score | None,
    training: Score,
    fit: FitQuality,
) -> Mapping[str, Any]:
    """What rig.json says of itself, with the board's own shape, which `check` needs."""
    shaped = bool(np.any(adjusted.shape_mm))
    return {
        "held_out": held_out.document() if held_out else None,
        "training": training.document(),
        "fit": {"sound": fit.is_sound, "doubts": fit.doubts},
        "sigma_inflation": covariance.inflation,
        "board": board.model_dump(),
        "board_corners_mm": adjusted.geometry.points_mm if shaped else None,
    }


def _depth_sigmas(rig: Rig, adjusted: Adjusted, covariance: RigCovariance) -> tuple[DepthSigma, ...]:
    geometry = adjusted.geometry
    depths = (geometry.board_rotation @ geometry.points_mm.T)[:, 2] + geometry.board_translation_mm[:, 2:]
    return tuple(
        depth_sigma(rig, covariance.matrix, float(d)) for d in np.quantile(depths, [0.05, 0.5, 0.95])
    )
