"""Monocular calibration of one camera by Zhang's method (the paper's Section 2.2.1).

The bundle adjustment of one camera refines its lens and the poses of the boards that it sees. With prior knowledge of
the lens the calibration starts at that lens.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.calibration.solver.bundle import Bundle, Geometry, Observations, estimate_robust_sigma
from beltscape.calibration.solver.lens import (
    LensPrior,
    compute_lens_prior,
    fit_view_pose,
    list_parameters,
    pack_intrinsics,
    unpack_intrinsics,
)
from beltscape.calibration.solver.levenberg_marquardt import Damping, minimise
from beltscape.calibration.solver.prior import BundlePrior
from beltscape.core.arrays import Array
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose


def set_up_adjustment(
    views: Mapping[str, Corners],
    camera: Camera,
    poses: Sequence[Pose],
    board_mm: Array,
    *,
    prior: tuple[Array, Array] | None = None,
    fixed: tuple[str, ...] = (),
    sigma_px: float = 1.0,
) -> tuple[Bundle, Geometry]:
    """Return the adjustment of a camera's lens and of the board's pose in each of its views, and its start.

    Parameters
    ----------
    poses
        cam_from_board of the views, in their order.
    prior
        Mean (W,) and information (W, W) of the intrinsics; None: no prior knowledge.
    fixed
        Parameters that keep their values.
    sigma_px
        One standard deviation of a corner's coordinate.
    """
    row = pack_intrinsics(camera)
    mean, information = prior or (row, np.zeros((len(row), len(row))))
    free = np.array([name not in fixed for name in list_parameters(camera.model)])
    known = BundlePrior((camera.model,), mean[None], information[None], free[None], board_mm, np.zeros(3))
    rotations, shifts = [pose.rotation for pose in poses], [pose.translation_mm for pose in poses]
    identity = np.eye(3)[None], np.zeros((1, 3))
    state = Geometry(row[None], *identity, np.stack(rotations), np.stack(shifts), board_mm)
    observed = Observations.from_views((0, i, c.ids, c.pixels) for i, c in enumerate(views.values()))
    return Bundle(replace(observed, sigma_px=np.full(len(observed.pixels), sigma_px)), known), state


MIN_VIEWS = 3
"""Zhang's equations need three views in general position."""
OUTLIER_FACTOR = 3.5
"""A view whose RMS exceeds the median view's by this factor is rejected."""
SINGULAR = 1e-12
"""Damping of normal equations that views leave singular: σ become a million times a good set's, not infinite."""


@dataclass(frozen=True, slots=True, eq=False)
class MonocularCalibration:
    """Calibration of one camera from its own views."""

    camera: Camera
    sigma: Mapping[str, float]
    """One standard deviation of fx, fy, cx, cy (px) and k1, k2, p1, p2, k3; 0 for a fixed one."""
    rms_px: float
    """Reprojection RMS over the views that the calibration used."""
    cam_from_board: Mapping[str, Pose]
    """By frame, for the views used."""
    view_rms_px: Mapping[str, float]
    """By frame, for the views used."""
    rejected: Mapping[str, str] = field(default_factory=dict[str, str])
    """Frame → reason of the rejection."""
    fixed: tuple[str, ...] = ()
    """Fixed parameters: those that the images do not determine, or all of a camera with given intrinsics."""
    prior: LensPrior | None = None
    """Given intrinsics that the bundle adjustment takes as a prior; the poses above hold for them."""

    def select(self, frames: Sequence[str]) -> MonocularCalibration:
        """Return the calibration with the poses of some frames only."""
        return replace(self, cam_from_board={frame: self.cam_from_board[frame] for frame in frames})


def calibrate_camera(
    name: str,
    detections: BoardDetections,
    board_mm: NDArray[np.float64],
    *,
    known: Camera | None = None,
    min_views: int = MIN_VIEWS,
) -> MonocularCalibration:
    """Calibrate intrinsics and distortion of one camera from board points (n, 3) in mm.

    The intrinsics of a ``known`` camera are fixed; only the board's poses are estimated. Views that fit far worse
    than the others are rejected with the reason; k3 is fixed at 0 unless it differs from 0 by more than three
    standard deviations.

    Raises
    ------
    CalibrationError
        When too few views show the board.

    References
    ----------
    Zhang, IEEE TPAMI 22(11), 2000, doi:10.1109/34.888718.
    """
    views, size = detections.views[name], detections.sizes_px[name]
    if len(views) < min_views:
        raise CalibrationError(
            f"camera {name} sees the board in {len(views)} of {detections.images[name]} images; "
            f"at least {min_views} tilted views are needed"
        )
    if known is not None:
        return reject_outlying_views(views, lambda kept: _fit_poses(name, kept, known, board_mm), min_views)
    return reject_outlying_views(views, lambda kept: _calibrate_views(name, kept, size, board_mm), min_views)


def reject_outlying_views(
    views: Mapping[str, Corners],
    fit: Callable[[Mapping[str, Corners]], MonocularCalibration],
    min_views: int = MIN_VIEWS,
) -> MonocularCalibration:
    """Return the fit to the views without those that fit far worse than the others; these are given with reasons."""
    kept, rejected = dict(views), dict[str, str]()
    solution = fit(kept)
    for _ in range(3):
        median = float(np.median(list(solution.view_rms_px.values())))
        limit = max(OUTLIER_FACTOR * median, 0.3)
        outliers = {frame: rms for frame, rms in solution.view_rms_px.items() if rms > limit}
        if not outliers or len(kept) - len(outliers) < max(min_views, len(kept) // 2):
            break
        for frame, rms in outliers.items():
            rejected[frame] = f"reprojection RMS {rms:.2f} px, the median view has {median:.2f} px"
            del kept[frame]
        solution = fit(kept)
    return replace(solution, rejected=rejected)


def _calibrate_views(
    name: str, views: Mapping[str, Corners], size: tuple[int, int], board_mm: NDArray[np.float64]
) -> MonocularCalibration:
    camera, poses = _run_opencv(name, views, size, board_mm, flags=0)
    free = _evaluate(*set_up_adjustment(views, camera, poses, board_mm), camera, views, ())
    if abs(float(camera.distortion[4])) > 3 * free.sigma["k3"]:
        return free
    fixed = _fit_without_k3(camera, poses, views, board_mm)
    if fixed is not None:
        return fixed
    camera, poses = _run_opencv(name, views, size, board_mm, flags=cv2.CALIB_FIX_K3)
    return _evaluate(
        *set_up_adjustment(views, camera, poses, board_mm, fixed=("k3",)), camera, views, ("k3",)
    )


def _fit_without_k3(
    camera: Camera, poses: Sequence[Pose], views: Mapping[str, Corners], board_mm: NDArray[np.float64]
) -> MonocularCalibration | None:
    """Refit with k3 fixed at 0, starting at the fit with free k3; return None if that does not converge."""
    start = replace(camera, distortion=np.append(camera.distortion[:4], 0.0))
    bundle, geometry = set_up_adjustment(views, start, poses, board_mm, fixed=("k3",))
    try:
        minimum = minimise(bundle, geometry, Damping(start=1e-9))  # k3 is within its σ of 0: nearly there
    except np.linalg.LinAlgError:
        return None
    if not minimum.converged:
        return None
    return _evaluate(
        bundle, minimum.state, unpack_intrinsics(camera, minimum.state.intrinsics[0]), views, ("k3",)
    )


def _evaluate(
    bundle: Bundle, state: Geometry, camera: Camera, views: Mapping[str, Corners], fixed: tuple[str, ...]
) -> MonocularCalibration:
    """Return the calibration at a minimum, with its residuals and the σ that follow from them."""
    squares = (bundle.compute_errors_px(state) ** 2).sum(axis=1)
    frame = bundle.observations.frame
    per_view = np.sqrt(np.bincount(frame, squares) / np.bincount(frame))
    variance = _compute_variance(bundle, state) / bundle.observations.sigma_px[0] ** 2
    freedom = max(2 * len(frame) - len(variance) - 6 * len(views), 1)
    parameters = list_parameters(camera.model)
    sigma = np.zeros(len(parameters))
    sigma[bundle.free] = np.sqrt(variance * squares.sum() / freedom)
    boards = zip(views, state.board_rotation, state.board_translation_mm, strict=True)
    return MonocularCalibration(
        camera=camera,
        sigma=dict(zip(parameters, sigma.tolist(), strict=True)),
        rms_px=float(np.sqrt(squares.mean())),
        cam_from_board={frame: Pose(rotation, translation) for frame, rotation, translation in boards},
        view_rms_px=dict(zip(views, per_view.tolist(), strict=True)),
        fixed=fixed,
    )


def refit_camera(
    calibration: MonocularCalibration, views: Mapping[str, Corners], board_mm: Array
) -> MonocularCalibration:
    """Return the calibration refitted to its views with other places of the board's corners, as of a measured shape.

    The views that it used and its fixed parameters stay the same.
    """
    used = {frame: views[frame] for frame in calibration.cam_from_board}
    camera, poses = calibration.camera, list(calibration.cam_from_board.values())
    bundle, state = set_up_adjustment(
        used, camera, poses, board_mm, prior=compute_lens_prior(camera), fixed=calibration.fixed,
        sigma_px=to_noise_px(calibration.rms_px),
    )  # fmt: skip
    state = minimise(bundle, state, Damping(tolerance=1e-7)).state
    found = _evaluate(bundle, state, unpack_intrinsics(camera, state.intrinsics[0]), used, calibration.fixed)
    return replace(found, rejected=calibration.rejected, prior=calibration.prior)


def _compute_variance(bundle: Bundle, state: Geometry) -> NDArray[np.float64]:
    """Return the variances of the free parameters from the corners' noise; huge if the views leave them free."""
    linear = bundle.linearise(state)
    try:
        return np.diag(linear.covariance())
    except np.linalg.LinAlgError:
        return np.diag(linear.covariance(SINGULAR))


def _fit_poses(
    name: str, views: Mapping[str, Corners], known: Camera, board_mm: NDArray[np.float64]
) -> MonocularCalibration:
    """Fit the board's poses with given intrinsics."""
    poses: dict[str, Pose] = {}
    rms: dict[str, float] = {}
    for frame, corners in views.items():
        points = board_mm[corners.ids]
        poses[frame] = fit_view_pose(known, points, corners.pixels, refine=True)
        errors = known.project(poses[frame].apply(points)) - corners.pixels
        errors = errors[np.isfinite(errors).all(axis=1)]
        rms[frame] = float(np.sqrt((errors**2).sum(axis=1).mean()))
    counts = np.array([len(corners) for corners in views.values()])
    total = float(np.sqrt((counts * np.square(list(rms.values()))).sum() / counts.sum()))
    parameters = list_parameters(known.model)
    return MonocularCalibration(
        replace(known, name=name), dict.fromkeys(parameters, 0.0), total, poses, rms, fixed=parameters
    )


def _run_opencv(
    name: str,
    views: Mapping[str, Corners],
    size: tuple[int, int],
    board_mm: NDArray[np.float64],
    *,
    flags: int,
) -> tuple[Camera, list[Pose]]:
    """Return the lens and the board's poses that OpenCV finds from its own start."""
    objects = [board_mm[corners.ids].astype(np.float32) for corners in views.values()]
    pixels = [corners.pixels.astype(np.float32).reshape(-1, 1, 2) for corners in views.values()]
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-6)
    try:
        _, matrix, distortion, rotations, translations = cv2.calibrateCamera(
            objects, pixels, size, None, None, flags=flags, criteria=criteria
        )
    except cv2.error as error:
        raise CalibrationError(
            f"camera {name}: its {len(views)} views do not determine the intrinsics; add views at other tilts"
        ) from error
    if not np.isfinite(matrix).all():
        raise CalibrationError(f"camera {name}: its views do not determine the intrinsics; add tilted views")
    focal = np.array([matrix[0, 0], matrix[1, 1]])
    camera = Camera(name, size, focal, matrix[:2, 2].copy(), distortion.ravel()[:5].copy())
    return camera, [Pose.of(r, t) for r, t in zip(rotations, translations, strict=True)]


START_NOISE_PX, LEAST_NOISE_PX = 0.3, 0.02
"""Noise of a corner that is assumed first, and the least that is assumed of residuals (detections reach 0.01 px)."""


@dataclass(frozen=True, slots=True, eq=False)
class LensGuess:
    """A lens that a camera is expected to have."""

    camera: Camera
    """Its size is that of the camera's images; the principal point is the guess's too."""
    focal_sigma: float
    """One standard deviation of the focal length about that of the guess, over the focal length."""
    fixed: tuple[str, ...] = ("k3",)
    """Parameters that keep the guess's value."""

    def compute_prior(self) -> tuple[Array, Array]:
        """Return mean (W,) and information (W, W): that of lenses in general, and the guessed focal length."""
        general, information = compute_lens_prior(self.camera)
        guess = np.zeros_like(information)
        guess[[0, 1], [0, 1]] = 1 / (self.focal_sigma * self.camera.focal_px) ** 2
        total = information + guess
        mean = np.linalg.solve(total, information @ general + guess @ pack_intrinsics(self.camera))
        return np.asarray(mean, np.float64), total


def fit_with_guess(views: Mapping[str, Corners], board_mm: Array, guess: LensGuess) -> MonocularCalibration:
    """Calibrate one camera from its views, started at a guessed lens, which is a prior of its focal length.

    Raises
    ------
    CalibrationError
        When the corners cannot be seen through the guessed lens, or the iteration does not converge.
    """
    poses = [fit_view_pose(guess.camera, board_mm[c.ids], c.pixels) for c in views.values()]
    names, camera, prior = list_parameters(guess.camera.model), guess.camera, guess.compute_prior()
    free = np.array([name not in guess.fixed for name in names])
    noise_px, state = START_NOISE_PX, None
    try:
        for tolerance in (1e-5, 1e-9):
            bundle, start = set_up_adjustment(
                views, camera, poses, board_mm, prior=prior, fixed=guess.fixed, sigma_px=noise_px
            )
            minimum = minimise(bundle, state or start, Damping(tolerance=tolerance))
            state, errors = minimum.state, bundle.compute_errors_px(minimum.state)
            noise_px = max(estimate_robust_sigma(errors), LEAST_NOISE_PX)
        variance = np.diag(bundle.linearise(minimum.state).covariance())
    except np.linalg.LinAlgError as error:
        raise CalibrationError(
            f"camera {camera.name}: no lens near the guessed one fits its views"
        ) from error
    if not (np.isfinite(errors).all() and (variance > 0).all()):
        raise CalibrationError(f"camera {camera.name}: no lens near the guessed one fits its views")
    return _summarise(
        views,
        camera,
        minimum.state,
        errors,
        dict(zip(np.array(names)[free], variance, strict=True)),
        guess,
    )


def to_noise_px(rms_px: float) -> float:
    """Return the noise of a corner's coordinate that is assumed for residuals of an RMS length."""
    return max(rms_px / np.sqrt(2), LEAST_NOISE_PX)


def _summarise(
    views: Mapping[str, Corners],
    camera: Camera,
    state: Geometry,
    errors_px: Array,
    variance: Mapping[str, float],
    guess: LensGuess,
) -> MonocularCalibration:
    squares = (errors_px**2).sum(axis=1)
    frame = np.repeat(np.arange(len(views)), [len(corners) for corners in views.values()])
    per_view = np.sqrt(np.bincount(frame, squares) / np.bincount(frame))
    boards = zip(views, state.board_rotation, state.board_translation_mm, strict=True)
    return MonocularCalibration(
        camera=unpack_intrinsics(camera, state.intrinsics[0]),
        sigma={name: float(np.sqrt(variance.get(name, 0.0))) for name in list_parameters(camera.model)},
        rms_px=float(np.sqrt(squares.mean())),
        cam_from_board={frame: Pose(rotation, shift) for frame, rotation, shift in boards},
        view_rms_px=dict(zip(views, per_view.tolist(), strict=True)),
        fixed=guess.fixed,
    )
