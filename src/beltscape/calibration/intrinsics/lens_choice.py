"""Choice of a camera's lens model by held-out error and parsimony, from the camera's own views.

Brown's model is the default. The rational and the fisheye model are tried where Brown's polynomial turns back within
the image, or where the normal equations at its minimum predict that more coefficients lower the residuals; a tilted
sensor where the principal point is off. They are taken if they fit views that they were not fitted to clearly better
(`beltscape.calibration.intrinsics.lens_evidence`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

import numpy as np

from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.intrinsics.lens_evidence import (
    MIN_CHOICE_VIEWS,
    MIN_GAIN,
    Gain,
    LensErrors,
    compare_errors,
    compute_own_errors,
    hold_out,
)
from beltscape.calibration.intrinsics.lens_fits import find_reach_px, fit_model, predict_gain
from beltscape.calibration.intrinsics.zhang import (
    MIN_VIEWS,
    MonocularCalibration,
    calibrate_camera,
    refit_camera,
)
from beltscape.core.arrays import Array
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.lens import BROWN
from beltscape.files.rig_limits import find_corner_radius_px, find_turning_radius_px

AUTO = "auto"
"""The request that the model be chosen: Brown's, the rational, the fisheye or the tilted one."""
RICHER = ("fisheye", "rational")
"""Models tried beside Brown's, from few to many coefficients."""
ODD_CENTER = 0.025
"""Distance of Brown's principal point from the middle, over the image's width, from which a tilted sensor is tried:
the tilt τ shifts it by f tan τ. Lenses without tilt stay below mostly; 0.025 is 1° with a lens of 40° of view."""
MAX_RATIO = 1.5
"""Largest ratio of the taken model's held-out RMS to that of any other; beyond it the best one is taken: a
coefficient too many costs less than errors that are twice as large."""
FAR_SHARE = 0.9
"""Reach of a rejected view over that of the farthest one, from which on the lens may be why it does not fit."""
TURNING_MARGIN = 1.05
"""Reach of the views over the radius at which a polynomial turns back, from which on it cannot be the lens: near that
radius it hardly rises, and a board seen there is squeezed."""


@dataclass(frozen=True, slots=True)
class LensChoice:
    """A camera's lens model, and why it was taken."""

    camera: str
    model: str
    reason: str
    """One line; empty for Brown's model by default."""
    held_out_px: Mapping[str, float]
    """RMS on views that each model was not fitted to, by model; NaN for a model that does not fit them."""
    is_requested: bool = False
    """Whether the model was asked for or stated, so that the views did not choose it."""


def calibrate_with_model(
    name: str,
    detections: BoardDetections,
    board_mm: Array,
    requested: str = AUTO,
    *,
    min_views: int = MIN_VIEWS,
    drawn_mm: Array | None = None,
    start: MonocularCalibration | None = None,
) -> tuple[MonocularCalibration, LensChoice]:
    """Calibrate one camera with the requested lens model, the one stated for it, or the one its views ask for.

    ``drawn_mm`` are the board's corners as drawn if ``board_mm`` are those of its measured shape, and ``start`` is
    a calibration with them.

    Raises
    ------
    CalibrationError
        When too few views show the board, or no model fits them.
    """
    stated = detections.types.get(name)
    if requested == AUTO and stated and stated.lens_model:
        requested = stated.lens_model
    brown: MonocularCalibration | None = None
    if requested in ("brown", "tilted", AUTO):
        try:
            brown = (
                calibrate_camera(name, detections, board_mm, min_views=min_views)
                if drawn_mm is None
                else _refit_brown(name, detections, board_mm, drawn_mm, start)
            )
        except CalibrationError:
            if requested == "brown" or len(detections.views[name]) < MIN_CHOICE_VIEWS:
                raise
    if requested not in ("brown", AUTO):
        fitted = fit_model(name, detections, board_mm, requested, brown, min_views)
        return fitted, LensChoice(name, requested, "as asked for", {}, is_requested=True)
    others = _list_others(brown, detections, board_mm) if requested == AUTO else ()
    if brown is not None and not others:
        return brown, LensChoice(name, "brown", "", {}, is_requested=requested != AUTO)
    return _compare(name, detections, board_mm, brown, others)


def _refit_brown(
    name: str,
    detections: BoardDetections,
    board_mm: Array,
    drawn_mm: Array,
    start: MonocularCalibration | None,
) -> MonocularCalibration:
    """Return the fit of Brown's model with a measured shape of the board; the closed solution needs a flat one."""
    if start is None or start.camera.model != BROWN.name:
        start = calibrate_camera(name, detections, drawn_mm)
    return refit_camera(start, detections.views[name], board_mm)


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


def _list_others(
    brown: MonocularCalibration | None, detections: BoardDetections, board_mm: Array
) -> tuple[str, ...]:
    """Return the models to compare with Brown's, from few to many coefficients; none if nothing asks for them."""
    if brown is None:
        return RICHER
    camera = brown.camera
    if len(detections.views[camera.name]) < MIN_CHOICE_VIEWS:
        return ()
    width, height = camera.size_px
    off = np.hypot(*(camera.center_px - [(width - 1) / 2, (height - 1) / 2]))
    tilted = ("tilted",) if off > ODD_CENTER * width else ()
    if (
        turns_within_image(camera)
        or _rejects_far_views(brown, detections)
        or predict_gain(brown, detections, board_mm) > 2 * MIN_GAIN
    ):
        return (RICHER[0], *tilted, *RICHER[1:])
    return tilted


def _rejects_far_views(brown: MonocularCalibration, detections: BoardDetections) -> bool:
    """Return whether views were left out that reach as far as any, which a wide lens would explain."""
    views = detections.views[brown.camera.name]
    reach = {frame: find_reach_px(brown.camera, {frame: view}) for frame, view in views.items()}
    return any(reach[frame] > FAR_SHARE * max(reach.values()) for frame in brown.rejected)


def _compare(
    name: str, detections: BoardDetections, board_mm: Array, brown: MonocularCalibration | None, others: Sequence[str]
) -> tuple[MonocularCalibration, LensChoice]:  # fmt: skip
    """Fit all models and take the best by held-out error and parsimony."""
    fits: dict[str, MonocularCalibration] = {} if brown is None else {"brown": brown}
    for model in others:
        with suppress(CalibrationError):
            fits[model] = fit_model(name, detections, board_mm, model, brown)
    if not fits:
        raise CalibrationError(
            f"camera {name}: no lens model fits its views; take tilted views that cover the image"
        )
    frames = [
        frame for frame in detections.views[name] if any(frame in f.cam_from_board for f in fits.values())
    ]
    errors = {model: hold_out(name, detections, board_mm, fit, frames) for model, fit in fits.items()}
    own = {model: compute_own_errors(detections, board_mm, fit) for model, fit in fits.items()}
    usable = [model for model in fits if errors[model].errors_px]
    folded = [model for model in usable if _turns_within_views(fits[model].camera, detections)]
    candidates = [model for model in usable if model not in folded] or usable or list(fits)
    compare = partial(_compare_pair, errors, own, detections, name)
    taken = candidates[0]
    for model in candidates[1:]:
        if compare(taken, model).is_clear:
            taken = model
    best = min(candidates, key=lambda model: errors[model].rms_px)
    if errors[taken].rms_px > MAX_RATIO * errors[best].rms_px:
        taken = best
    rms = {model: each.rms_px if each.errors_px else float("nan") for model, each in errors.items()}
    return fits[taken], LensChoice(name, taken, _describe(taken, fits, errors, folded, compare), rms)


def _compare_pair(
    held_out: Mapping[str, LensErrors],
    own: Mapping[str, LensErrors],
    detections: BoardDetections,
    name: str,
    first: str,
    second: str,
) -> Gain:
    """Return the gain from one model to another: by held-out views from Brown's, else by all views."""
    return compare_errors(held_out if first == BROWN.name else own, (first, second), detections, name)


def _turns_within_views(camera: Camera, detections: BoardDetections) -> bool:
    """Return whether the lens model turns back where corners were seen; beyond them it is not known anyway."""
    reach = find_reach_px(camera, detections.views[camera.name])
    return find_turning_radius_px(camera) < TURNING_MARGIN * reach


def _describe(
    taken: str,
    fits: Mapping[str, MonocularCalibration],
    errors: Mapping[str, LensErrors],
    folded: Sequence[str],
    compare: Callable[[str, str], Gain],
) -> str:
    """Return why a model was taken, with the figures."""
    others = ", ".join(f"{model} {each.rms_px:.3f}" for model, each in errors.items() if model != taken)
    figures = f"held-out RMS {errors[taken].rms_px:.3f} px" + (f" ({others})" if others else "")
    if "brown" not in fits:
        return f"the polynomial does not fit the views; {figures}"
    if "brown" in folded and taken != "brown":
        turning = find_turning_radius_px(fits["brown"].camera)
        return f"the polynomial turns back {turning:.0f} px from the principal point, among the corners; {figures}"
    if not errors["brown"].errors_px:
        return f"the polynomial does not fit views that it was not fitted to; {figures}"
    if taken != "brown":
        gain = compare("brown", taken).describe()
        return f"its errors on held-out views are clearly smaller than those of brown ({gain}); {figures}"
    best = min(
        (model for model in fits if model != "brown"), key=lambda model: errors[model].rms_px, default=""
    )
    gain = f" ({best}: {compare('brown', best).describe()})" if best else ""
    return f"no other model is clearly better{gain}; {figures}"
