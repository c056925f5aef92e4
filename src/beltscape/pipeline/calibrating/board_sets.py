"""Sets of boards made ready for the calibration: one rigid object with known places, or views of single boards."""

from __future__ import annotations

from beltscape.calibration.bundle_adjustment import adjust_bundle
from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.calibration.intrinsics.lens_choice import AUTO, calibrate_with_model
from beltscape.calibration.intrinsics.zhang import MonocularCalibration, calibrate_camera
from beltscape.calibration.network.face_poses import Sighting, estimate_face_poses
from beltscape.calibration.solver.deterministic import single_thread
from beltscape.calibration.solver.lens_prior import LensPrior
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.core.type_guards import is_dict
from beltscape.files.documents.json_text import to_plain
from beltscape.pipeline.calibrating.board_views import split_boards
from beltscape.pipeline.calibrating.intrinsics import compute_lens_covariance
from beltscape.pipeline.calibrating.known_intrinsics import KnownIntrinsics
from beltscape.target.board import Board, BoardSet, corner_points_mm

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
        return detections, board, known
    split = split_boards(detections, board)
    if not board.rigid:
        return split, board, known
    lenses, instants = _calibrate_boards(split, board, known, lens_model)
    if not board.is_placed:
        with single_thread():
            board = estimate_face_poses(instants, board)
    priors = {name: prior for name, prior in lenses.items() if name not in known.cameras}
    cameras = {**{name: prior.camera for name, prior in priors.items()}, **known.cameras}
    return detections, board, KnownIntrinsics(cameras, known.source, {**priors, **known.priors})


def _calibrate_boards(
    split: BoardDetections, board: BoardSet, known: KnownIntrinsics, lens_model: str
) -> tuple[dict[str, LensPrior], list[list[Sighting]]]:
    """Return weak priors of the lenses, and what was seen at each instant, from the boards as independent ones.

    The cameras are calibrated together if they share views of single boards, else each by itself.
    """
    flat = board.unplace()
    number = {face.name: k for k, face in enumerate(board.faces)}
    monocular = _calibrate_lenses(split, board, known, lens_model)
    covariances = {
        name: WEAKENING * compute_lens_covariance(split, calibration, corner_points_mm(flat))
        for name, calibration in monocular.items()
    }
    lenses = {name: LensPrior(each.camera, covariances[name]) for name, each in monocular.items()}
    instants: dict[str, list[Sighting]] = {}
    try:
        hierarchy = solve_hierarchy(
            split, flat, None, Silent(), known=known.cameras, priors=known.priors,
            lens_models={name: each.camera.model for name, each in monocular.items()},
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
    lenses.update({name: LensPrior(rig.cameras[name], covariances[name]) for name in same_model})
    return lenses, list(instants.values())


def _calibrate_lenses(
    split: BoardDetections, board: BoardSet, known: KnownIntrinsics, lens_model: str
) -> dict[str, MonocularCalibration]:
    """Calibrate each camera that has enough views of single boards."""
    board_mm = corner_points_mm(board.unplace())
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
    if not isinstance(board, BoardSet):
        return detections, board
    if not board.rigid:
        return split_boards(detections, board), board
    document = to_plain(rig.quality.get("board"))
    former = (
        BoardSet.model_validate(document) if is_dict(document) and document.get("kind") == "boards" else None
    )
    if not board.is_placed and former is not None and former.unplace() == board.unplace():
        return detections, former
    if board.is_placed:
        return detections, board
    lenses = KnownIntrinsics(rig.cameras, "the rig")
    resolved, placed, _ = resolve_board_set(detections, board, lenses)
    return resolved, placed
