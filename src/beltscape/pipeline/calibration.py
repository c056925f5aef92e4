"""Capture and board → rig, scores and report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.calibrate.adjust import Adjusted, adjust
from beltscape.calibrate.blame import blame
from beltscape.calibrate.chain import Chain, skewed_pairs, solve
from beltscape.calibrate.corners import Sightings
from beltscape.calibrate.detect import Variant
from beltscape.calibrate.guidance import NextPose, next_pose
from beltscape.calibrate.heldout import HeldOut, held_out_score
from beltscape.calibrate.score import Evidence, Score, examine, score
from beltscape.calibrate.sightings import find_board
from beltscape.calibrate.uncertainty import DepthSigma, RigCovariance, depth_sigma, rig_covariance
from beltscape.core.camera import Camera
from beltscape.core.errors import InputError
from beltscape.core.progress import Recording, Reporter
from beltscape.core.rig import Rig
from beltscape.files.capture import Capture, read_capture
from beltscape.kernels import load
from beltscape.target.board import Board

SPLIT_LIMIT = 2.0
"""Halves of the views may differ so much more than their covariances say."""
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
    warnings: tuple[str, ...]


def calibrate(
    folder: Path,
    board: Board,
    core: str | None,
    reporter: Reporter,
    *,
    known: Mapping[str, Camera] | None = None,
) -> Calibration:
    """Calibrate the rig of a capture of board views; the intrinsics of ``known`` cameras are held as they are.

    Raises
    ------
    InputError, CalibrationError
        With one line that names what is wrong and the mend.
    """
    reporter = Recording(reporter)
    capture = read_capture(folder)
    if len(capture.cameras) < 2:
        raise InputError(
            f"{folder}: only camera {', '.join(capture.cameras)} has images; a rig needs two: "
            "give the folder above the camera folders"
        )
    if core is not None and core not in capture.cameras:
        raise InputError(f"{folder}: no camera {core} in it; it has {', '.join(capture.cameras)}")
    sightings, variant = find_board(capture, board, reporter)
    chain = solve(sightings, board, core, reporter, known=known)
    _warn_of_disagreement(chain, reporter)
    kernels = load()
    own = chain.sightings
    reporter.step("adjusting everything together", 0, 1)
    adjusted = adjust(chain, board)
    covariance = rig_covariance(adjusted)
    reporter.step("adjusting everything together", 1, 1)
    evidence = examine(adjusted.rig, own, board, kernels, corners_mm=adjusted.geometry.points_mm)
    reporter.step("scoring on held-out views", 0, 1)
    halves = held_out_score(own, board, chain.rig.core, kernels, known=known)
    held_out = halves.score if halves else None
    reporter.step("scoring on held-out views", 1, 1)
    _warn_of_doubt(board, adjusted, halves, reporter)
    training = score(evidence)
    rig = replace(
        adjusted.rig,
        quality=_quality(board, adjusted, covariance, held_out, training),
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
        warnings=tuple(reporter.warnings),
    )


def _warn_of_disagreement(chain: Chain, reporter: Reporter) -> None:
    """Say which pairs fit worse than their cameras alone, and who opens the loops."""
    skewed = skewed_pairs(chain)
    if skewed:
        sizes = ", ".join(f"{pair.first}–{pair.second} {pair.rms_px:.2f} px" for pair in skewed)
        alone = max(chain.monocular[name].rms_px for pair in skewed for name in (pair.first, pair.second))
        reporter.warn(
            f"cameras fit worse together than alone (at most {alone:.2f} px): {sizes}; they are not triggered at the "
            "same instant, or one of them moved"
        )
    guilty = blame(chain.network)
    if guilty is not None:
        reporter.warn(guilty)


def _warn_of_doubt(board: Board, adjusted: Adjusted, halves: HeldOut | None, reporter: Reporter) -> None:
    """Say it where the model does not explain the views, or the board's size is not believable."""
    if halves is not None and halves.split_ratio > SPLIT_LIMIT:
        reporter.warn(
            f"the rigs of even and odd frames differ {halves.split_ratio:.1f} times more than their standard "
            "deviations allow: the stated σ are too small; look for moving cameras, blur or a bending board"
        )
    distance = float(np.median(adjusted.geometry.board_translation_mm[:, 2]))
    if not NEAREST_MM < distance < FARTHEST_MM:
        factor, unit = (10, "centimetres") if distance < NEAREST_MM else (0.001, "micrometres")
        reporter.warn(
            f"with square_mm = {board.square_mm:g} the board was {distance:.3g} mm away; was it given in {unit} "
            f"({board.square_mm * factor:g} mm)?"
        )


def _quality(
    board: Board, adjusted: Adjusted, covariance: RigCovariance, held_out: Score | None, training: Score
) -> Mapping[str, Any]:
    """What rig.json says of itself, with the board's own shape, which `check` needs."""
    shaped = bool(np.any(adjusted.shape_mm))
    return {
        "held_out": held_out.document() if held_out else None,
        "training": training.document(),
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
