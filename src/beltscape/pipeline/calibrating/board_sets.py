"""Sets of boards made ready for the calibration: one rigid object with known places, or views of single boards."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from beltscape.calibration.bundle_adjustment import adjust_bundle
from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.calibration.intrinsics.lens_choice import AUTO, calibrate_with_model
from beltscape.calibration.intrinsics.zhang import MonocularCalibration, calibrate_camera
from beltscape.calibration.network.face_poses import Sighting, estimate_face_poses
from beltscape.calibration.network.two_sides import has_two_sides, number_sides, place_back
from beltscape.calibration.solver.lens import LensPrior
from beltscape.calibration.solver.levenberg_marquardt import single_thread
from beltscape.core.checks import is_dict
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.files.json_text import to_plain
from beltscape.pipeline.calibrating.intrinsics import KnownIntrinsics, compute_lens_covariance
from beltscape.pipeline.calibrating.views import split_boards
from beltscape.target.board import Board, BoardSet, PlanarBoard, corner_points_mm

WEAKENING = 1e4
"""Factor on the covariance of lenses from single boards, which start the adjustment of an object: the same corners
determine them again, so that they must not count twice."""


def resolve_board_set(
    detections: BoardDetections, board: Board, known: KnownIntrinsics, lens_model: str = AUTO
) -> tuple[BoardDetections, Board, KnownIntrinsics]:
    """Return detections, board and the intrinsics to start from, as the calibration of a rig needs them.

    One board passes unchanged. Independent boards become frames of their own. For the faces of an object, whose
    corners are not in one plane, lenses are estimated from single faces, and so are places that board.toml lacks.

    Raises
    ------
    CalibrationError
        When the place of a board cannot be estimated.
    """
    if not isinstance(board, BoardSet):
        if not has_two_sides(detections):
            return detections, board, known
        return _resolve_two_sides(detections, board, known, lens_model)
    split = split_boards(detections, board)
    if not board.rigid:
        return split, board, known
    lenses, instants = _calibrate_boards(split, board, known, lens_model)
    if not board.is_placed:
        with single_thread():
            board = estimate_face_poses(instants, board)
    return detections, board, _start_from(lenses, known)


def _resolve_two_sides(
    detections: BoardDetections, board: PlanarBoard, known: KnownIntrinsics, lens_model: str
) -> tuple[BoardDetections, Board, KnownIntrinsics]:
    """Return the print on the back as a face of its own, placed where the views need it."""
    monocular = _calibrate_lenses(detections, board, known, lens_model)
    lenses = _weaken_lenses(monocular, detections, board)
    hierarchy = solve_hierarchy(
        detections, board, None, Silent(), known={name: each.camera for name, each in monocular.items()}
    )
    numbered, sides = number_sides(detections, board)
    with single_thread():
        placed = place_back(numbered, sides, hierarchy.rig, hierarchy.monocular)
    return numbered, placed, _start_from(lenses, known)


def _start_from(lenses: Mapping[str, LensPrior], known: KnownIntrinsics) -> KnownIntrinsics:
    """Return the intrinsics to start from: the known ones, and weak priors of the others."""
    priors = {name: prior for name, prior in lenses.items() if name not in known.cameras}
    cameras = {**{name: prior.camera for name, prior in priors.items()}, **known.cameras}
    return KnownIntrinsics(cameras, known.source, {**priors, **known.priors})


def _calibrate_boards(
    split: BoardDetections, board: BoardSet, known: KnownIntrinsics, lens_model: str
) -> tuple[dict[str, LensPrior], list[list[Sighting]]]:
    """Return weak priors of the lenses, and what was seen at each instant, from the boards as independent ones.

    The cameras are calibrated together if they share views of single boards, else each by itself.
    """
    flat = board.unplace()
    number = {face.name: k for k, face in enumerate(board.faces)}
    monocular = _calibrate_lenses(split, flat, known, lens_model)
    lenses = _weaken_lenses(monocular, split, flat)
    instants: dict[str, list[Sighting]] = {}
    try:
        hierarchy = solve_hierarchy(
            split, flat, None, Silent(), known=known.cameras, priors=known.priors,
            lens_models={name: each.camera.model for name, each in monocular.items()}, is_start=True,
        )  # fmt: skip
        adjusted = adjust_bundle(hierarchy, flat)
    except CalibrationError:
        for name, calibration in monocular.items():
            for key, pose in calibration.cam_from_board.items():
                frame, face = key.rsplit("/", 1)
                seen = Sighting(
                    number[face], split.views[name][key], calibration.camera, Pose.identity(), pose
                )
                instants.setdefault(f"{frame}/{name}", []).append(seen)
        return lenses, list(instants.values())
    geometry, rig = adjusted.geometry, adjusted.rig
    for i, key in enumerate(adjusted.frames):
        frame, face = key.rsplit("/", 1)
        pose = Pose(geometry.board_rotation[i], geometry.board_translation_mm[i])
        for name, camera in rig.cameras.items():
            if key in split.views[name] and key not in hierarchy.monocular[name].rejected:
                seen = Sighting(number[face], split.views[name][key], camera, rig.cam_from_core[name], pose)
                instants.setdefault(frame, []).append(seen)
    same_model = [name for name in rig.cameras if rig.cameras[name].model == lenses[name].camera.model]
    lenses.update({name: replace(lenses[name], camera=rig.cameras[name]) for name in same_model})
    return lenses, list(instants.values())


def _weaken_lenses(
    monocular: Mapping[str, MonocularCalibration], detections: BoardDetections, flat: Board
) -> dict[str, LensPrior]:
    """Return the lenses from single boards as priors that count almost nothing."""
    board_mm = corner_points_mm(flat)
    return {
        name: LensPrior(each.camera, WEAKENING * compute_lens_covariance(detections, each, board_mm))
        for name, each in monocular.items()
    }


def _calibrate_lenses(
    split: BoardDetections, flat: Board, known: KnownIntrinsics, lens_model: str
) -> dict[str, MonocularCalibration]:
    """Calibrate each camera that has enough views of single boards, whose corners all have z = 0."""
    board_mm = corner_points_mm(flat)
    monocular: dict[str, MonocularCalibration] = {}
    for name in split.cameras:
        try:
            with single_thread():
                monocular[name] = (
                    calibrate_camera(name, split, board_mm, known=known.cameras[name])
                    if name in known.cameras
                    else calibrate_with_model(name, split, board_mm, lens_model)[0]
                )
        except CalibrationError:
            continue  # the calibration of the rig reports the camera
    return monocular


def resolve_checked_set(detections: BoardDetections, board: Board, rig: Rig) -> tuple[BoardDetections, Board]:
    """Return detections and board for a check of a rig; places come from the rig's calibration with the same set."""
    document = to_plain(rig.quality.get("board"))
    former = (
        BoardSet.model_validate(document) if is_dict(document) and document.get("kind") == "boards" else None
    )
    if not isinstance(board, BoardSet):
        if former is not None and former.is_two_sided and former.faces[0].board == board:
            return number_sides(detections, board)[0], former
        if has_two_sides(detections):
            return resolve_board_set(detections, board, KnownIntrinsics(rig.cameras, "the rig"))[:2]
        return detections, board
    if not board.rigid:
        return split_boards(detections, board), board
    if not board.is_placed and former is not None and former.unplace() == board.unplace():
        return detections, former
    if board.is_placed:
        return detections, board
    lenses = KnownIntrinsics(rig.cameras, "the rig")
    resolved, placed, _ = resolve_board_set(detections, board, lenses)
    return resolved, placed
