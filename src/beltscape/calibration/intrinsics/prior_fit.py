"""Monocular calibration with prior knowledge of the lens, started at that lens."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import Corners
from beltscape.calibration.intrinsics.one_camera import set_up_adjustment
from beltscape.calibration.intrinsics.zhang import MonocularCalibration
from beltscape.calibration.solver.bundle_data import Geometry
from beltscape.calibration.solver.lens import (
    compute_lens_prior,
    list_parameters,
    pack_intrinsics,
    unpack_intrinsics,
)
from beltscape.calibration.solver.levenberg_marquardt import Damping, minimise
from beltscape.calibration.solver.perspective import fit_view_pose
from beltscape.calibration.solver.robust import estimate_robust_sigma
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose

Array = NDArray[np.float64]

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
        variance = np.diag(bundle.linearise(state).covariance())
    except np.linalg.LinAlgError as error:
        raise CalibrationError(
            f"camera {camera.name}: no lens near the guessed one fits its views"
        ) from error
    if not (np.isfinite(errors).all() and (variance > 0).all()):
        raise CalibrationError(f"camera {camera.name}: no lens near the guessed one fits its views")
    return _summarise(
        views, camera, state, errors, dict(zip(np.array(names)[free], variance, strict=True)), guess
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
