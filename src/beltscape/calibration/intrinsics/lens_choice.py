"""Choice of a camera's lens model by held-out error and parsimony, from the camera's own views.

Brown's model is the default. The rational and the fisheye model are tried where Brown's polynomial turns back within
the image, or where the normal equations at its minimum predict that more coefficients lower the residuals. They are
taken if they fit views that they were not fitted to clearly better.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.calibration.intrinsics.lens_starts import list_starts
from beltscape.calibration.intrinsics.prior_fit import LEAST_NOISE_PX, LensGuess, fit_with_guess
from beltscape.calibration.intrinsics.zhang import (
    MIN_VIEWS,
    MonocularCalibration,
    calibrate_camera,
    reject_outlying_views,
)
from beltscape.calibration.solver.bundle import Bundle
from beltscape.calibration.solver.bundle_data import BundlePrior, Geometry, Observations
from beltscape.calibration.solver.lens import (
    compute_lens_prior,
    list_parameters,
    pack_intrinsics,
    unpack_intrinsics,
)
from beltscape.calibration.solver.levenberg_marquardt import Damping, minimise
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.files.rig_limits import find_corner_radius_px, find_turning_radius_px

Array = NDArray[np.float64]
Views = Mapping[str, Corners]

AUTO = "auto"
"""The request that the model be chosen among Brown's, the rational and the fisheye model."""
RICHER = ("fisheye", "rational")
"""Models tried beside Brown's, from few to many coefficients."""
MIN_GAIN = 0.15
"""Least relative decrease of the held-out RMS for another model than Brown's; a board that is bent by 0.1 mm makes
5 % through a normal lens, a lens of 100° that is described by the polynomial 50 %."""
SIGNIFICANCE = 2.0
"""Standard errors over the views by which the decrease must exceed 0."""
FOLDS = 4
"""Number of parts of the views, each held out once."""
REFITTING = Damping(tolerance=1e-5, iterations=15)
"""Number of parts of the views, each held out once."""
MIN_CHOICE_VIEWS = 8
"""Least number of views for a comparison: two in every fold."""
MAX_OUTSIDE = 0.005
"""Largest share of held-out corners beyond a model's domain; more make the model unfit for the lens."""


@dataclass(frozen=True, slots=True)
class LensChoice:
    """A camera's lens model, and why it was taken."""

    camera: str
    model: str
    reason: str
    """One line; empty for Brown's model by default."""
    held_out_px: Mapping[str, float]
    """RMS on views that each model was not fitted to, by model; NaN for a model that does not fit them."""


def calibrate_with_model(
    name: str,
    detections: BoardDetections,
    board_mm: Array,
    requested: str = AUTO,
    *,
    min_views: int = MIN_VIEWS,
) -> tuple[MonocularCalibration, LensChoice]:
    """Calibrate one camera with the requested lens model, or with the one that its views ask for.

    Raises
    ------
    CalibrationError
        When too few views show the board, or no model fits them.
    """
    if requested not in ("brown", AUTO):
        fitted = _fit(detections.views[name], name, detections, board_mm, requested, None, min_views)
        return fitted, LensChoice(name, requested, "as asked for", {})
    brown: MonocularCalibration | None = None
    try:
        brown = calibrate_camera(name, detections, board_mm, min_views=min_views)
    except CalibrationError:
        if requested == "brown" or len(detections.views[name]) < MIN_CHOICE_VIEWS:
            raise
    if brown is not None and (requested == "brown" or not _asks_for_more(brown, detections, board_mm)):
        return brown, LensChoice(name, "brown", "", {})
    return _compare(name, detections, board_mm, brown)


def describe_choices(choices: Sequence[LensChoice]) -> list[str]:
    """Return a line for every camera whose lens model was compared with others."""
    return [
        f"camera {choice.camera}: lens model {choice.model}: {choice.reason}"
        for choice in choices
        if choice.held_out_px
    ]


def turns_within_image(camera: Camera) -> bool:
    """Return whether the lens model turns back before the image's farthest corner."""
    return find_turning_radius_px(camera) < find_corner_radius_px(camera)


def _asks_for_more(brown: MonocularCalibration, detections: BoardDetections, board_mm: Array) -> bool:
    if len(detections.views[brown.camera.name]) < MIN_CHOICE_VIEWS:
        return False
    return turns_within_image(brown.camera) or predict_gain(brown, detections, board_mm) > 2 * MIN_GAIN


def predict_gain(brown: MonocularCalibration, detections: BoardDetections, board_mm: Array) -> float:
    """Return the share of the squared residuals that the rational model removes, to first order (a score test)."""
    views = detections.views[brown.camera.name]
    used = {frame: views[frame] for frame in brown.cam_from_board}
    camera = replace(
        brown.camera, model="rational", distortion=np.concatenate([brown.camera.distortion, np.zeros(3)])
    )
    prior = pack_intrinsics(camera), compute_lens_prior(camera)[1]
    poses = list(brown.cam_from_board.values())
    bundle, state = _set_up(used, camera, poses, board_mm, brown.rms_px, prior)
    try:
        linear = bundle.linearise(state)
        return linear.predict_decrease(linear.solve_step(0.0)) / linear.cost
    except np.linalg.LinAlgError:
        return 0.0


def _compare(
    name: str, detections: BoardDetections, board_mm: Array, brown: MonocularCalibration | None
) -> tuple[MonocularCalibration, LensChoice]:
    """Fit all models and take the best by held-out error and parsimony."""
    fits: dict[str, MonocularCalibration] = {} if brown is None else {"brown": brown}
    for model in RICHER:
        with suppress(CalibrationError):
            fits[model] = _fit(detections.views[name], name, detections, board_mm, model, brown, MIN_VIEWS)
    if not fits:
        raise CalibrationError(
            f"camera {name}: no lens model fits its views; take tilted views that cover the image"
        )
    errors = {model: _hold_out(name, detections, board_mm, fit) for model, fit in fits.items()}
    rms = {
        model: float(np.sqrt(np.mean(list(each.values())))) if each else float("nan")
        for model, each in errors.items()
    }
    usable = [model for model in fits if errors[model]]
    folded = [model for model in usable if turns_within_image(fits[model].camera)]
    candidates = [model for model in usable if model not in folded] or usable or list(fits)
    taken = candidates[0]
    for model in candidates[1:]:
        if _is_better(errors[taken], errors[model]):
            taken = model
    return fits[taken], LensChoice(name, taken, _describe(taken, fits, rms, folded), rms)


def _fit(
    views: Views,
    name: str,
    detections: BoardDetections,
    board_mm: Array,
    model: str,
    brown: MonocularCalibration | None,
    min_views: int,
) -> MonocularCalibration:
    """Return the best fit of a model over its starts, without outlying views."""
    if len(views) < min_views:
        raise CalibrationError(
            f"camera {name} sees the board in {len(views)} of {detections.images[name]} images; "
            f"at least {min_views} tilted views are needed"
        )
    size = detections.sizes_px[name]
    fits: list[MonocularCalibration] = []
    for start in list_starts(name, size, views, board_mm, model, brown.camera if brown else None):
        guess = LensGuess(start, 1.0, fixed=())
        with suppress(CalibrationError):
            fits.append(
                reject_outlying_views(views, lambda kept, guess=guess: fit_with_guess(kept, board_mm, guess))
            )
    if not fits:
        raise CalibrationError(f"camera {name}: the lens model {model} does not fit its views")
    return min(fits, key=lambda fit: (-len(fit.cam_from_board), fit.rms_px))


def _hold_out(
    name: str,
    detections: BoardDetections,
    board_mm: Array,
    whole: MonocularCalibration,
) -> dict[str, float]:
    """Return mean squared errors (px²) of views under the lens fitted to the others; empty if it fits badly."""
    kept = detections.restrict([name], whole.cam_from_board)
    found: dict[str, float] = {}
    outside = corners = 0
    for train, test in _list_folds(tuple(kept.views[name])):
        rest = kept.restrict([name], train)
        try:
            lens = _refit(rest.views[name], whole, board_mm)
            scored = calibrate_camera(name, kept.restrict([name], test), board_mm, known=lens, min_views=1)
        except (CalibrationError, np.linalg.LinAlgError):
            return {}
        for frame, pose in scored.cam_from_board.items():
            view = kept.views[name][frame]
            seen = np.isfinite(lens.project(pose.apply(board_mm[view.ids]))).all(axis=1)
            outside, corners = outside + int((~seen).sum()), corners + len(view)
            found[frame] = scored.view_rms_px[frame] ** 2
    return found if outside <= MAX_OUTSIDE * corners else {}


def _refit(views: Views, whole: MonocularCalibration, board_mm: Array) -> Camera:
    """Return the lens that fits some of the views, started at the fit to all of them."""
    camera, poses = whole.camera, [whole.cam_from_board[frame] for frame in views]
    prior = compute_lens_prior(camera)
    bundle, state = _set_up(views, camera, poses, board_mm, whole.rms_px, prior, whole.fixed)
    return unpack_intrinsics(camera, minimise(bundle, state, REFITTING).state.intrinsics[0])


def _set_up(
    views: Views,
    camera: Camera,
    poses: Sequence[Pose],
    board_mm: Array,
    rms_px: float,
    prior: tuple[Array, Array],
    fixed: tuple[str, ...] = (),
) -> tuple[Bundle, Geometry]:
    """Return the adjustment of one camera's lens and board poses, with a lens prior (mean, information)."""
    free = np.array([name not in fixed for name in list_parameters(camera.model)])
    row = pack_intrinsics(camera)
    known = BundlePrior((camera.model,), prior[0][None], prior[1][None], free[None], board_mm, np.zeros(3))
    state = Geometry(
        row[None], np.eye(3)[None], np.zeros((1, 3)),
        np.stack([pose.rotation for pose in poses]), np.stack([pose.translation_mm for pose in poses]), board_mm,
    )  # fmt: skip
    observed = Observations.from_views((0, i, c.ids, c.pixels) for i, c in enumerate(views.values()))
    noise = np.full(len(observed.pixels), max(rms_px / np.sqrt(2), LEAST_NOISE_PX))
    return Bundle(replace(observed, sigma_px=noise), known), state


def _list_folds(frames: tuple[str, ...]) -> Iterator[tuple[list[str], list[str]]]:
    """Yield training and test frames; a fold is a run of frames, so that near-identical ones are in one."""
    for test in np.array_split(np.arange(len(frames)), FOLDS):
        inside = set(test.tolist())
        yield (
            [frame for i, frame in enumerate(frames) if i not in inside],
            [frame for i, frame in enumerate(frames) if i in inside],
        )


def _is_better(first: Mapping[str, float], second: Mapping[str, float]) -> bool:
    """Return whether the second model's errors are clearly smaller, in the mean over the views' logarithms."""
    common = [frame for frame in first if frame in second]
    if len(common) < MIN_CHOICE_VIEWS:
        return False
    gains = np.array([0.5 * np.log(max(first[f], 1e-12) / max(second[f], 1e-12)) for f in common])
    error = float(gains.std(ddof=1) / np.sqrt(len(gains)))
    return float(gains.mean()) > max(SIGNIFICANCE * error, -np.log1p(-MIN_GAIN))


def _describe(
    taken: str, fits: Mapping[str, MonocularCalibration], rms: Mapping[str, float], folded: list[str]
) -> str:
    others = ", ".join(f"{model} {value:.3f}" for model, value in rms.items() if model != taken)
    figures = f"held-out RMS {rms[taken]:.3f} px" + (f" ({others})" if others else "")
    if "brown" in folded and taken != "brown":
        turning = find_turning_radius_px(fits["brown"].camera)
        return f"the polynomial turns back {turning:.0f} px from the principal point, within the image; {figures}"
    if "brown" not in fits:
        return f"the polynomial does not fit the views; {figures}"
    return f"{'the smallest error' if taken != 'brown' else 'others are not clearly better'}: {figures}"
