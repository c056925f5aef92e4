"""Fits of a camera's lens models to its own views, and their errors on views that they were not fitted to."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.calibration.intrinsics.lens_starts import list_fixed, list_starts, select_views
from beltscape.calibration.intrinsics.one_camera import set_up_adjustment
from beltscape.calibration.intrinsics.prior_fit import LensGuess, fit_with_guess, to_noise_px
from beltscape.calibration.intrinsics.zhang import (
    MIN_VIEWS,
    MonocularCalibration,
    calibrate_camera,
    reject_outlying_views,
)
from beltscape.calibration.solver.lens import (
    compute_lens_prior,
    pack_intrinsics,
    unpack_intrinsics,
)
from beltscape.calibration.solver.levenberg_marquardt import Damping, minimise
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera

Array = NDArray[np.float64]
Views = Mapping[str, Corners]

FOLDS = 6
"""Number of parts of the views, each held out once: the standard error of a comparison comes from their scatter."""
REFITTING = Damping(tolerance=1e-5, iterations=15)
"""Fits to some of the views start at the fit to all of them."""
RANKING_VIEWS = 12
"""Views that choose among several starts; false minima differ from the true one by many px in any of them."""
MAX_OUTSIDE = 0.005
"""Largest share of held-out corners beyond a model's domain; more make the model unfit for the lens."""


@dataclass(frozen=True, slots=True)
class HeldOutErrors:
    """Errors of views under the lens fitted to the other folds."""

    squares: Mapping[str, float]
    """Mean squared error by view, px²; empty if the model does not fit views that it was not fitted to."""
    fold: Mapping[str, int]
    """By view."""

    @property
    def rms_px(self) -> float:
        """Return the RMS over the views; NaN without any."""
        return float(np.sqrt(np.mean(list(self.squares.values())))) if self.squares else float("nan")


def fit_model(
    name: str, detections: BoardDetections, board_mm: Array, model: str, brown: MonocularCalibration | None,
    min_views: int = MIN_VIEWS,
) -> MonocularCalibration:  # fmt: skip
    """Return the best fit of a model over its starts, without outlying views.

    Raises
    ------
    CalibrationError
        When the views are too few, or the model does not fit them.
    """
    views = detections.views[name]
    if len(views) < min_views:
        raise CalibrationError(
            f"camera {name} sees the board in {len(views)} of {detections.images[name]} images; "
            f"at least {min_views} tilted views are needed"
        )
    starts = list_starts(
        name, detections.sizes_px[name], views, board_mm, model, brown.camera if brown else None
    )
    guesses = [LensGuess(start, 1.0, fixed=list_fixed(model)) for start in starts]
    for guess in _rank_guesses(guesses, select_views(views, RANKING_VIEWS), board_mm):
        with suppress(CalibrationError):
            return reject_outlying_views(
                views, lambda kept, guess=guess: fit_with_guess(kept, board_mm, guess)
            )
    raise CalibrationError(f"camera {name}: the lens model {model} does not fit its views")


def _rank_guesses(guesses: list[LensGuess], views: Views, board_mm: Array) -> list[LensGuess]:
    """Return the guesses, that which leads to the smallest residuals of some views first, continued from there."""
    if len(guesses) == 1:
        return guesses
    ranked: list[tuple[float, LensGuess]] = []
    for guess in guesses:
        try:
            fit = fit_with_guess(views, board_mm, guess)
            ranked.append((fit.rms_px, replace(guess, camera=fit.camera)))
        except CalibrationError:
            ranked.append((np.inf, guess))
    return [guess for _, guess in sorted(ranked, key=lambda each: each[0])]


def predict_gain(brown: MonocularCalibration, detections: BoardDetections, board_mm: Array) -> float:
    """Return the share of the squared residuals that the rational model removes, to first order (a score test)."""
    views = detections.views[brown.camera.name]
    used = {frame: views[frame] for frame in brown.cam_from_board}
    camera = replace(
        brown.camera, model="rational", distortion=np.concatenate([brown.camera.distortion, np.zeros(3)])
    )
    prior = pack_intrinsics(camera), compute_lens_prior(camera)[1]
    poses = list(brown.cam_from_board.values())
    bundle, state = set_up_adjustment(
        used, camera, poses, board_mm, prior=prior, sigma_px=to_noise_px(brown.rms_px)
    )
    try:
        linear = bundle.linearise(state)
        return linear.predict_decrease(linear.solve_step(0.0)) / linear.cost
    except np.linalg.LinAlgError:
        return 0.0


def hold_out(
    name: str, detections: BoardDetections, board_mm: Array, whole: MonocularCalibration
) -> HeldOutErrors:
    """Return the errors of the views of each fold under the lens fitted to the others."""
    kept = detections.restrict([name], whole.cam_from_board)
    squares: dict[str, float] = {}
    folds: dict[str, int] = {}
    outside = corners = 0
    for number, (train, test) in enumerate(_list_folds(tuple(kept.views[name]))):
        rest = kept.restrict([name], train)
        try:
            lens = _refit(rest.views[name], whole, board_mm)
            scored = calibrate_camera(name, kept.restrict([name], test), board_mm, known=lens, min_views=1)
        except (CalibrationError, np.linalg.LinAlgError):
            return HeldOutErrors({}, {})
        for frame, pose in scored.cam_from_board.items():
            view = kept.views[name][frame]
            seen = np.isfinite(lens.project(pose.apply(board_mm[view.ids]))).all(axis=1)
            outside, corners = outside + int((~seen).sum()), corners + len(view)
            squares[frame], folds[frame] = scored.view_rms_px[frame] ** 2, number
    return HeldOutErrors(squares, folds) if outside <= MAX_OUTSIDE * corners else HeldOutErrors({}, {})


def _refit(views: Views, whole: MonocularCalibration, board_mm: Array) -> Camera:
    """Return the lens that fits some of the views, started at the fit to all of them."""
    camera, poses = whole.camera, [whole.cam_from_board[frame] for frame in views]
    prior = compute_lens_prior(camera)
    bundle, state = set_up_adjustment(
        views, camera, poses, board_mm, prior=prior, fixed=whole.fixed, sigma_px=to_noise_px(whole.rms_px)
    )
    return unpack_intrinsics(camera, minimise(bundle, state, REFITTING).state.intrinsics[0])


def _list_folds(frames: tuple[str, ...]) -> Iterator[tuple[list[str], list[str]]]:
    """Yield training and test frames; a fold is a run of frames, so that near-identical ones are in one."""
    for test in np.array_split(np.arange(len(frames)), min(FOLDS, len(frames) // 2)):
        inside = set(test.tolist())
        yield (
            [frame for i, frame in enumerate(frames) if i not in inside],
            [frame for i, frame in enumerate(frames) if i in inside],
        )
