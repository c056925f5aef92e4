"""Comparison of the calibration with OpenCV's on recorded sets, with the same corners and folds; prints tables.

    python benchmarks/opencv_calibration.py [REAL]

REAL is a folder with the sets of `SETS` (default: ../shared/data/real beside the repository); missing ones are left
out. Every lens and rig is scored by one function on frames that it was not calibrated with, to which only the board's
pose is fitted.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.assessment.cross_validation import list_folds
from beltscape.calibration.bundle_adjustment import adjust_bundle
from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.calibration.intrinsics.lens_choice import calibrate_with_model
from beltscape.calibration.network.resection import fit_board_pose
from beltscape.calibration.network.two_sides import number_sides
from beltscape.calibration.solver.levenberg_marquardt import single_thread
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.files.capture import read_capture
from beltscape.pipeline.calibrating.board_sets import resolve_board_set
from beltscape.pipeline.calibrating.intrinsics import KnownIntrinsics
from beltscape.pipeline.calibrating.views import detect_rig_board
from beltscape.target.board import Board, BoardSet, CharucoBoard, Chessboard, corner_points_mm

Array = NDArray[np.float64]
Calibrated = tuple[Rig, Array]
"""A rig, and the board's corners (P, 3) as it was calibrated with them."""

_CHARUCO = CharucoBoard(squares=(4, 5), square_mm=54, marker_mm=40.5, dictionary="DICT_4X4_1000")
SETS: dict[str, tuple[str, Board, bool]] = {
    "stereo pair, chessboard": ("opencv_stereo", Chessboard(corners=(9, 6), square_mm=25), True),
    "three close-range cameras": (
        "pycamset_calibration_charuco",
        CharucoBoard(squares=(20, 20), square_mm=4, marker_mm=3.2, dictionary="DICT_4X4_1000"),
        True,
    ),
    "four webcams": ("caliscope_4cam", _CHARUCO, True),
    "four webcams, two-sided board": ("caliscope_two_sided/images", _CHARUCO, True),
    "four phones, one after the other": (
        "pose2sim_intrinsics/images", Chessboard(corners=(4, 7), square_mm=60), False,
    ),
}  # fmt: skip
"""Folder, board, and whether the cameras share views, by the name in the table."""
CRITERIA = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-10)
MIN_COMMON = 6


def compare(folder: Path) -> list[str]:
    """Return the tables of single cameras and of rigs."""
    single = [
        "| single cameras, held out | cameras | views | method | RMS px | median px |",
        "|---|---|---|---|---|---|",
    ]
    joint = [
        "| rigs, held out | cameras | frames | method | RMS px | median px |",
        "|---|---|---|---|---|---|",
    ]
    for title, (name, board, is_rig) in SETS.items():
        if not (folder / name).is_dir():
            continue
        detections, _ = detect_rig_board(read_capture(folder / name), board, Silent())
        single += _compare_single(title, detections, board)
        joint += _compare_rigs(title, detections, board) if is_rig else []
    return [*single, "", *joint]


def _compare_single(title: str, detections: BoardDetections, board: Board) -> Iterator[str]:
    """Yield a row for each method: every camera by itself, each fold under the lens from the others."""
    board_mm = corner_points_mm(board)
    methods: dict[str, Callable[[BoardDetections, str], Camera]] = {
        "OpenCV, 5 coefficients": lambda views, name: _calibrate_opencv(views, name, board_mm, 0),
        "OpenCV, 8 coefficients": lambda views, name: _calibrate_opencv(
            views, name, board_mm, cv2.CALIB_RATIONAL_MODEL
        ),
        "Beltscape": lambda views, name: calibrate_with_model(name, views, board_mm)[0].camera,
    }
    for method, calibrate in methods.items():
        errors = [
            _score(Rig(name, {name: lens}, {name: Pose.identity()}), board_mm, own.restrict([name], test))
            for name in detections.cameras
            for own in [detections.restrict([name], detections.frames)]
            for train, test in _split(own, tuple(own.views[name]))
            for lens in [calibrate(own.restrict([name], train), name)]
        ]
        views = sum(len(each) for each in detections.views.values())
        yield f"| {title} | {len(detections.cameras)} | {views} | {method} | {_summarise(errors)} |"


def _compare_rigs(title: str, detections: BoardDetections, board: Board) -> Iterator[str]:
    """Yield a row for each method: all cameras together, each fold under the rig from the others."""
    hierarchy = solve_hierarchy(detections, board, None, Silent())
    names = tuple(hierarchy.rig.cameras)
    detections = hierarchy.detections.restrict(names, hierarchy.detections.frames)
    frames = tuple(f for f in detections.frames if sum(f in detections.views[n] for n in names) > 1)
    methods: dict[str, Callable[[BoardDetections], Calibrated]] = {
        "OpenCV, calibrateCamera and stereoCalibrate": lambda views: _chain_opencv(views, names, board),
        "Beltscape": lambda views: _calibrate_beltscape(views, names[0], board),
    }
    for method, calibrate in methods.items():
        errors: list[Array] = []
        for train, test in _split(detections, frames):
            rig, board_mm = calibrate(detections.restrict(names, train))
            seen = detections.restrict(names, test)
            if len(board_mm) > len(corner_points_mm(board)) and not isinstance(board, BoardSet):
                seen = number_sides(seen, board)[0]
            errors.append(_score(rig, board_mm, seen))
        yield f"| {title} | {len(names)} | {len(frames)} | {method} | {_summarise(errors)} |"


def _split(
    detections: BoardDetections, frames: tuple[str, ...]
) -> Iterator[tuple[list[str], tuple[str, ...]]]:
    """Yield the frames to calibrate with and those to score, as the calibration's own score divides them."""
    for test in next(iter(list_folds(detections, frames))):
        yield [frame for frame in detections.frames if frame not in test], test


def _score(rig: Rig, board_mm: Array, detections: BoardDetections) -> Array:
    """Return reprojection errors (n,), px, with the board's pose fitted to all cameras of a frame."""
    errors: list[Array] = []
    for frame in detections.frames:
        views = {name: own[frame] for name, own in detections.views.items() if frame in own}
        if len(views) < min(2, len(rig.cameras)):
            continue
        pose = fit_board_pose(rig, views, board_mm)
        for name, corners in views.items():
            in_camera = (rig.cam_from_core[name] @ pose).apply(board_mm[corners.ids])
            errors.append(np.linalg.norm(rig.cameras[name].project(in_camera) - corners.pixels, axis=1))
    return np.concatenate(errors)


def _summarise(errors: Sequence[Array]) -> str:
    lengths = np.concatenate(errors)
    return f"{np.sqrt(np.nanmean(lengths**2)):.3f} | {np.nanmedian(lengths):.3f}"


def _calibrate_opencv(detections: BoardDetections, name: str, board_mm: Array, flags: int) -> Camera:
    views, size = detections.views[name], detections.sizes_px[name]
    points = [board_mm[view.ids].astype(np.float32) for view in views.values()]
    pixels = [view.pixels.astype(np.float32).reshape(-1, 1, 2) for view in views.values()]
    _, matrix, lens, _, _ = cv2.calibrateCamera(
        points, pixels, size, None, None, flags=flags, criteria=CRITERIA
    )  # fmt: skip
    return _make_camera(name, size, np.asarray(matrix), np.asarray(lens))


def _make_camera(name: str, size: tuple[int, int], matrix: Array, lens: Array) -> Camera:
    count = 8 if lens.size >= 8 and np.any(lens.ravel()[5:8]) else 5
    model = "rational" if count == 8 else "brown"
    return Camera(
        name, size, np.diag(matrix)[:2].copy(), matrix[:2, 2].copy(), lens.ravel()[:count].copy(), model
    )


def _chain_opencv(detections: BoardDetections, names: Sequence[str], board: Board) -> Calibrated:
    """Return the rig of OpenCV's lenses, and its pairs along the most common views."""
    board_mm = corner_points_mm(board)
    cameras = {name: _calibrate_opencv(detections, name, board_mm, 0) for name in names}
    poses, rest = {names[0]: Pose.identity()}, list(names[1:])
    while rest:
        pairs = {(a, b): _find_common(detections, a, b) for a in poses for b in rest}
        (a, b), common = max(pairs.items(), key=lambda each: len(each[1]))
        poses[b] = _calibrate_pair(detections, cameras[a], cameras[b], common, board_mm) @ poses[a]
        rest.remove(b)
    return Rig(names[0], cameras, {name: poses[name] for name in names}), board_mm


def _find_common(detections: BoardDetections, first: str, second: str) -> dict[str, NDArray[np.int64]]:
    views = detections.views
    both = {
        f: np.intersect1d(v.ids, views[second][f].ids) for f, v in views[first].items() if f in views[second]
    }
    return {frame: ids for frame, ids in both.items() if len(ids) >= MIN_COMMON}


def _calibrate_pair(
    detections: BoardDetections,
    a: Camera,
    b: Camera,
    common: Mapping[str, NDArray[np.int64]],
    board_mm: Array,
) -> Pose:
    def pixels(camera: Camera) -> list[NDArray[np.float32]]:
        views = {frame: detections.views[camera.name][frame] for frame in common}
        rows = {frame: np.searchsorted(view.ids, common[frame]) for frame, view in views.items()}
        return [views[frame].pixels[rows[frame]].astype(np.float32).reshape(-1, 1, 2) for frame in common]

    points = [board_mm[ids].astype(np.float32) for ids in common.values()]
    found = cv2.stereoCalibrate(
        points, pixels(a), pixels(b), a.matrix, a.distortion, b.matrix, b.distortion, a.size_px,
        flags=cv2.CALIB_FIX_INTRINSIC, criteria=CRITERIA,
    )  # fmt: skip
    return Pose(np.asarray(found[5], np.float64), np.asarray(found[6], np.float64).ravel())


def _calibrate_beltscape(detections: BoardDetections, core: str, board: Board) -> Calibrated:
    views, resolved, start = resolve_board_set(detections, board, KnownIntrinsics({}))
    hierarchy = solve_hierarchy(views, resolved, core, Silent(), known=start.cameras, priors=start.priors)
    adjusted = adjust_bundle(hierarchy, resolved)
    return adjusted.rig, adjusted.geometry.points_mm


if __name__ == "__main__":
    default = Path(__file__).parents[2] / "shared" / "data" / "real"
    with single_thread():
        print("\n".join(compare(Path(sys.argv[1]) if len(sys.argv) > 1 else default)))
