"""Capture and board → rig, scores and report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.calibrate.adjust import Adjusted, adjust
from beltscape.calibrate.blame import blame
from beltscape.calibrate.chain import Chain, skewed_pairs, solve
from beltscape.calibrate.corners import Sightings
from beltscape.calibrate.detect import Variant
from beltscape.calibrate.guidance import NextPose, next_pose
from beltscape.calibrate.heldout import HeldOut, held_out_score
from beltscape.calibrate.network import Misclosure
from beltscape.calibrate.score import Evidence, Score, examine, score
from beltscape.calibrate.sightings import find_board
from beltscape.calibrate.uncertainty import DepthSigma, RigCovariance, depth_sigma, rig_covariance
from beltscape.core.camera import Camera
from beltscape.core.errors import CalibrationError, InputError
from beltscape.core.frames import Image
from beltscape.core.progress import Recording, Reporter
from beltscape.core.rig import Rig
from beltscape.files.atomic import write_text
from beltscape.files.capture import Capture, read_capture
from beltscape.files.images import read_image
from beltscape.files.json_text import plain, write_json
from beltscape.files.rig_json import write_rig
from beltscape.kernels import load
from beltscape.report.calibration import calibration_page
from beltscape.target.board import Board

SPLIT_LIMIT = 2.0
"""Halves of the views may differ so much more than their covariances say."""
SHOWN = 12
"""Rejected views shown in the report."""
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
    own = sightings.restricted(chain.rig.cameras, sightings.frames)
    reporter.step("adjusting everything together", 0, 1)
    adjusted = adjust(chain, own, board)
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
        quality=_quality(board, adjusted, held_out, training),
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
        next_pose=next_pose(adjusted, covariance.matrix),
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


def _quality(board: Board, adjusted: Adjusted, held_out: Score | None, training: Score) -> Mapping[str, Any]:
    """What rig.json says of itself, with the board's own shape, which `check` needs."""
    shaped = bool(np.any(adjusted.shape_mm))
    return {
        "held_out": held_out.document() if held_out else None,
        "training": training.document(),
        "board": board.model_dump(),
        "board_corners_mm": adjusted.geometry.points_mm if shaped else None,
    }


def _depth_sigmas(rig: Rig, adjusted: Adjusted, covariance: RigCovariance) -> tuple[DepthSigma, ...]:
    geometry = adjusted.geometry
    depths = (geometry.board_rotation @ geometry.points_mm.T)[:, 2] + geometry.board_translation_mm[:, 2:]
    return tuple(
        depth_sigma(rig, covariance.matrix, float(d)) for d in np.quantile(depths, [0.05, 0.5, 0.95])
    )


def write_calibration(out: Path, calibration: Calibration) -> None:
    """rig.json, calibration.json and report.html."""
    write_rig(out / "rig.json", calibration.rig)
    write_json(out / "calibration.json", calibration_document(calibration))
    page = calibration_page(
        calibration.chain,
        calibration.adjusted,
        calibration.evidence,
        calibration.board,
        calibration.depth_sigma,
        calibration.next_pose,
        _rejected_images(calibration),
        held_out=calibration.held_out,
        training=calibration.training,
        warnings=calibration.warnings,
    )
    write_text(out / "report.html", page)


def _rejected_images(calibration: Calibration) -> list[tuple[str, Image]]:
    """(why, image) of the views that were left out as a whole, for the report."""
    found: list[tuple[str, Image]] = []
    for name, camera in calibration.chain.monocular.items():
        for frame, why in camera.rejected.items():
            image = read_image(calibration.capture.files[name][frame])
            found.append((f"{name}, frame {frame}: {why}", image))
    return found[:SHOWN]


def check(folder: Path, rig: Rig, board: Board, reporter: Reporter) -> tuple[Score, Evidence]:
    """Score a rig on board views it has never seen.

    Raises
    ------
    InputError, CalibrationError
        With one line that names what is wrong and the mend.
    """
    capture = read_capture(folder)
    for name in rig.cameras:
        if name not in capture.cameras:
            reporter.warn(f"{folder / name}: no images of camera {name}; going on without it")
    known = capture.only(tuple(rig.cameras))
    if len(known.cameras) < 2:
        raise InputError(
            f"{folder}: has the cameras {', '.join(capture.cameras)}, the rig {', '.join(rig.cameras)}; "
            "at least two of them must be the same"
        )
    sightings, _ = find_board(known, board, reporter)
    for name, size in sightings.sizes_px.items():
        if size != rig.cameras[name].size_px:
            width, height = rig.cameras[name].size_px
            raise InputError(
                f"{folder / name}: images are {size[0]}×{size[1]} px, the rig's {name} has {width}×{height}; "
                "check with images of the size the rig was calibrated with"
            )
    try:
        evidence = examine(rig, sightings, board, load(), corners_mm=_known_shape(rig, board))
    except CalibrationError as error:
        raise CalibrationError(f"{folder}: {error}") from error
    return score(evidence), evidence


def _known_shape(rig: Rig, board: Board) -> NDArray[np.float64] | None:
    """(P, 3) the board's own shape, where the rig was found with the same board and it was not as drawn."""
    corners = rig.quality.get("board_corners_mm")
    if corners is None or rig.quality.get("board") != plain(board.model_dump()):
        return None
    points = np.asarray(corners, np.float64)
    return points if points.shape == (board.grid[0] * board.grid[1], 3) else None


def calibration_document(calibration: Calibration) -> Mapping[str, Any]:
    """calibration.json: what each level of the hierarchy found."""
    chain, adjusted = calibration.chain, calibration.adjusted
    return {
        "format": "beltscape-calibration/1",
        "core": chain.rig.core,
        "board": {
            **calibration.board.model_dump(),
            **({} if calibration.board.kind == "chessboard" else _variant_document(calibration.variant)),
            "off_drawing_rms_mm": np.sqrt((adjusted.shape_mm**2).mean(axis=0)),
        },
        "held_out": calibration.held_out.document() if calibration.held_out else None,
        "training": calibration.training.document(),
        "depth_sigma_mm": [
            {"depth_mm": s.depth_mm, "median": np.nanmedian(s.sigma_mm), "worst": np.nanmax(s.sigma_mm)}
            for s in calibration.depth_sigma
        ],
        "next_pose": _next_document(calibration.next_pose),
        "cameras": {name: _camera_document(calibration, name) for name in calibration.rig.cameras},
        "pairs": [
            {
                "cameras": [pair.first, pair.second],
                "frames": len(pair.frames),
                "corners": pair.corners,
                "rms_px": pair.rms_px,
                "rotation": pair.second_from_first.rotation,
                "translation_mm": pair.second_from_first.translation_mm,
                "rejected": pair.rejected,
            }
            for pair in chain.network.pairs
        ],
        "path_errors": [_closure_document(error) for error in chain.network.path_errors],
        "loop_errors": [_closure_document(error) for error in chain.network.loop_errors],
        "warnings": calibration.warnings,
    }


def _closure_document(error: Misclosure) -> Mapping[str, Any]:
    return {
        "cameras": error.cameras,
        "rotation_deg": error.rotation_deg,
        "translation_mm": error.translation_mm,
        "chi2_per_dof": error.chi2_per_dof,
        "p_value": error.p_value,
    }


def _next_document(pose: NextPose | None) -> Mapping[str, Any] | None:
    if pose is None:
        return None
    return {
        "enough": pose.enough,
        "words": pose.describe(),
        "seen_by": pose.seen_by,
        "sigma_now_mm": pose.sigma_now_mm,
        "sigma_then_mm": pose.sigma_then_mm,
        "core_from_board": {
            "rotation": pose.core_from_board.rotation,
            "translation_mm": pose.core_from_board.translation_mm,
        },
    }


def _camera_document(calibration: Calibration, name: str) -> Mapping[str, Any]:
    camera, adjusted = calibration.chain.monocular[name], calibration.adjusted
    final, index = calibration.rig.cameras[name], list(calibration.rig.cameras).index(name)
    covariance = calibration.covariance
    sigma = np.sqrt(np.diag(covariance.matrix))
    of_camera = adjusted.bundle.observations.camera == index
    return {
        "images": calibration.sightings.images[name],
        "board_seen": len(calibration.sightings.views[name]),
        "views_used": len(camera.cam_from_board),
        "focal_px": final.focal_px,
        "center_px": final.center_px,
        "distortion": final.distortion,
        "sigma": {
            parameter.removeprefix(f"{name}."): float(value)
            for parameter, value in zip(covariance.parameters, sigma, strict=True)
            if parameter.startswith(f"{name}.")
        },
        "held": camera.held,
        "noise_px": adjusted.sigma_px[index],
        "corners": int(of_camera.sum()),
        "corners_left_out": int((of_camera & ~adjusted.kept).sum()),
        "intrinsics_from_own_views": name in adjusted.alone,
        "monocular": {
            "rms_px": camera.rms_px,
            "focal_px": camera.camera.focal_px,
            "center_px": camera.camera.center_px,
            "distortion": camera.camera.distortion,
            "sigma": camera.sigma,
        },
        "rejected": camera.rejected,
        "path_from_core": calibration.chain.network.paths[name],
    }


def _variant_document(variant: Variant) -> dict[str, bool]:
    return {"legacy": variant.legacy, "inverted": variant.inverted}
