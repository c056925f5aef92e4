"""Delays of the cameras against the core, measured from images of a moving board and the times of its instants.

A camera that exposes later shows a moving board where it is then. In every frame the board's pose is free, and each
camera's delay moves its corners along their own motion in its image; all delays are fitted together by least squares.
The standard deviations come from the scatter between frames, so that errors of the rig, which do not follow the
motion, are in them. The core's delay is 0 by definition: an instant's time is that of its image.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.calibration.network.resection import fit_board_pose
from beltscape.core.arrays import Array, Mask
from beltscape.core.errors import CalibrationError, InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose, rotation_from_vector, vector_from_rotation
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.files.capture import read_capture
from beltscape.files.encoder_csv import read_encoder
from beltscape.files.times_csv import FILE as TIMES
from beltscape.files.times_csv import read_times
from beltscape.health.images.synchronisation import CameraDelay
from beltscape.pipeline.calibrating.board_sets import resolve_checked_set
from beltscape.pipeline.calibrating.views import detect_rig_board
from beltscape.target.board import Board, corner_points_mm

LEAST_FRAMES = 10
"""Frames with a known motion below which nothing is fitted. Chosen: fewer give no scatter between frames."""
_NEIGHBOURS = 5
"""Frames about one from which its motion is fitted, as a cubic in time: of a board that swings once in two seconds,
seen ten times a second, the speed is then right to 0.3 %."""
_WINDOW_S = 0.8
"""Longest time that these may span: within it a hand's motion is a cubic."""
_LEAST_CORNERS = 8
"""Corners from which a camera counts as seeing the board."""
_STEP_S = 1e-3
"""Step by which positions in the images are differentiated; their error falls with its square, 1e-6 px here."""
_STEP_RAD, _STEP_MM = 1e-4, 0.05
"""Steps by which they are differentiated by the board's pose."""
Views = Mapping[str, Corners]


def measure_trigger_delays(
    folder: Path, rig: Rig, board: Board, belt_mm_s: float, reporter: Reporter
) -> dict[str, CameraDelay]:
    """Return each auxiliary's delay from a capture of a board that is carried about; lengths are of a belt's travel.

    Raises
    ------
    InputError, CalibrationError
        Where the capture has no times, or the board was seen too rarely or hardly moved.
    """
    capture = read_capture(folder, rig.cameras).select_cameras(tuple(rig.cameras))
    times_s = read_instant_times(folder)
    detections, _ = detect_rig_board(capture, board, reporter, known=rig.cameras)
    detections, board = resolve_checked_set(detections, board, rig)
    return estimate_delays(rig, detections, times_s, corner_points_mm(board), belt_mm_s)


def read_instant_times(folder: Path) -> dict[str, float]:
    """Return the time of each frame in seconds, by times.csv or encoder.csv; InputError where there is neither."""
    if (folder / TIMES).is_file():
        return read_times(folder / TIMES)
    path = folder / "encoder.csv"
    if not path.is_file():
        raise InputError(
            f"{folder}: has neither {TIMES} nor encoder.csv; record it with beltscape record --sequence, which "
            "writes the time of every instant"
        )
    return {one.frame: one.time_ns * 1e-9 for one in read_encoder(path)}


def estimate_delays(
    rig: Rig, detections: BoardDetections, times_s: Mapping[str, float], board_mm: Array, belt_mm_s: float
) -> dict[str, CameraDelay]:
    """Return each auxiliary's delay; its displacement is that of a belt of the given speed.

    Raises
    ------
    CalibrationError
        Where the board was seen too rarely, or hardly moved.
    """
    views = _collect_views(rig, detections, times_s)
    poses = _fit_poses(rig, views, board_mm)
    names = rig.auxiliaries
    normal, right = np.zeros((len(names), len(names))), np.zeros(len(names))
    parts: list[tuple[Array, Array]] = []
    for frame in poses:
        motion = _fit_motion(frame, poses, times_s, board_mm.mean(axis=0))
        if motion is None:
            continue
        part = _reduce_frame(rig, views[frame], poses[frame], motion, board_mm)
        parts.append(part)
        normal, right = normal + part[0], right + part[1]
    if len(parts) < LEAST_FRAMES:
        raise CalibrationError(
            f"{len(parts)} frames show the moving board to two cameras with neighbours in time, {LEAST_FRAMES} are "
            "needed: carry it about before all cameras, for longer or at a higher rate"
        )
    seen = np.diag(normal) > 0
    return {
        name: delay
        for name, delay in zip(names, _solve(normal, right, parts, seen, belt_mm_s), strict=True)
        if delay is not None
    }


def _solve(
    normal: Array, right: Array, parts: Sequence[tuple[Array, Array]], seen: Mask, belt_mm_s: float
) -> list[CameraDelay | None]:
    """Return the delays with σ from the scatter of the frames' gradients (sandwich estimate); None: never seen."""
    index = np.flatnonzero(seen)
    part = np.ix_(index, index)
    if not len(index) or np.linalg.cond(normal[part]) > 1e12:
        raise CalibrationError(
            "the board hardly moved: swing it, about once in two seconds, before all cameras"
        )
    inverse = np.linalg.inv(normal[part])
    delays_s = inverse @ right[index]
    gradients = np.array([g[index] - n[part] @ delays_s for n, g in parts])
    count = len(parts)
    covariance = inverse @ (gradients.T @ gradients) @ inverse * count / max(count - len(index), 1)
    result: list[CameraDelay | None] = [None] * len(right)
    for place, delay, variance in zip(index, delays_s, np.diag(covariance), strict=True):
        sigma_s = float(np.sqrt(variance))
        result[place] = CameraDelay(float(delay) * belt_mm_s, sigma_s * belt_mm_s, belt_mm_s)
    return result


def _collect_views(
    rig: Rig, detections: BoardDetections, times_s: Mapping[str, float]
) -> dict[str, dict[str, Corners]]:
    """Return frame → camera → corners of frames with a time that the core and another camera see."""
    found: dict[str, dict[str, Corners]] = {}
    for frame in sorted((one for one in detections.frames if one in times_s), key=times_s.__getitem__):
        own = {
            name: detections.views[name][frame]
            for name in rig.cameras
            if frame in detections.views.get(name, {})
            and len(detections.views[name][frame]) >= _LEAST_CORNERS
        }
        if rig.core in own and len(own) >= 2:
            found[frame] = own
    return found


def _fit_poses(rig: Rig, views: Mapping[str, Views], board_mm: Array) -> dict[str, Pose]:
    """Return core_from_board of each frame; without frames in which none fits."""
    poses: dict[str, Pose] = {}
    for frame, own in views.items():
        try:
            poses[frame] = fit_board_pose(rig, own, board_mm)
        except (CalibrationError, np.linalg.LinAlgError):
            continue  # too oblique for a pose; the others tell enough, or too few are left
    return poses


def _fit_motion(
    frame: str, poses: Mapping[str, Pose], times_s: Mapping[str, float], centre_mm: Array
) -> tuple[Array, Array, Array] | None:
    """Return the board's centre (3,), its velocity (3,) mm/s and its turning (3,) rad/s; None: too few neighbours."""
    now_s, pose = times_s[frame], poses[frame]
    near = sorted(poses, key=lambda one: abs(times_s[one] - now_s))[:_NEIGHBOURS]
    dt = np.array([times_s[one] - now_s for one in near])
    if len(near) < _NEIGHBOURS or np.ptp(dt) > _WINDOW_S or dt.min() >= 0 or dt.max() <= 0:
        return None
    centre = pose.apply(centre_mm)
    samples = np.array(
        [
            [
                *(poses[one].apply(centre_mm) - centre),
                *vector_from_rotation(poses[one].rotation @ pose.rotation.T),
            ]
            for one in near
        ]
    )
    coefficients, *_ = np.linalg.lstsq(np.vander(dt, 4, increasing=True), samples, rcond=None)
    return centre, coefficients[1, :3], coefficients[1, 3:]


def _reduce_frame(
    rig: Rig, views: Views, pose: Pose, motion: tuple[Array, Array, Array], board_mm: Array
) -> tuple[Array, Array]:
    """Return a frame's normal matrix (K, K) and right side (K,) of the delays, s, its pose eliminated."""
    centre, velocity, turning = motion
    columns = {name: k for k, name in enumerate(rig.auxiliaries)}
    by_pose: list[Array] = []
    by_delay: list[Array] = []
    residuals: list[Array] = []
    for name, corners in views.items():
        cam_from_core, lens = rig.cam_from_core[name], rig.cameras[name]
        points = pose.apply(board_mm[corners.ids])

        def project(moved: Array, cam_from_core: Pose = cam_from_core, lens: Camera = lens) -> Array:
            return lens.project(cam_from_core.apply(moved)).ravel()

        step = _STEP_S * (velocity + np.cross(turning, points - centre))
        slope = np.zeros((2 * len(points), len(columns)))
        if name in columns:
            slope[:, columns[name]] = (project(points + step) - project(points - step)) / (2 * _STEP_S)
        by_delay.append(slope)
        by_pose.append(_differentiate_by_pose(project, points, centre))
        residuals.append(corners.pixels.ravel() - project(points))
    design, delays, errors = np.concatenate(by_pose), np.concatenate(by_delay), np.concatenate(residuals)
    usable = np.isfinite(errors) & np.isfinite(design).all(axis=1) & np.isfinite(delays).all(axis=1)
    basis, _ = np.linalg.qr(design[usable])
    free = delays[usable] - basis @ (basis.T @ delays[usable])
    return free.T @ free, free.T @ errors[usable]


def _differentiate_by_pose(project: Callable[[Array], Array], points: Array, centre: Array) -> Array:
    """Return the derivatives (2N, 6) of the pixels by the board's translation, mm, and its turn, rad."""
    columns: list[Array] = []
    for axis in np.eye(3):
        step = _STEP_MM * axis
        columns.append((project(points + step) - project(points - step)) / (2 * _STEP_MM))
    for axis in np.eye(3):
        turned = [
            (points - centre) @ rotation_from_vector(sign * _STEP_RAD * axis).T + centre for sign in (1, -1)
        ]
        columns.append((project(turned[0]) - project(turned[1])) / (2 * _STEP_RAD))
    return np.column_stack(columns)
