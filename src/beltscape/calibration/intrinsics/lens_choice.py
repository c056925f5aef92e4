"""Choice of a camera's lens model by held-out error and parsimony, from the camera's own views.

Brown's model is the default. The rational and the fisheye model are tried where Brown's polynomial turns back within
the image, or where the normal equations at its minimum predict that more coefficients lower the residuals; a tilted
sensor where the principal point is off. They are taken if they fit views that they were not fitted to clearly better.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.intrinsics.lens_fits import (
    HeldOutErrors,
    find_reach_px,
    fit_model,
    hold_out,
    predict_gain,
)
from beltscape.calibration.intrinsics.zhang import MIN_VIEWS, MonocularCalibration, calibrate_camera
from beltscape.core.arrays import Array
from beltscape.core.errors import CalibrationError
from beltscape.core.geometry.camera import Camera
from beltscape.files.rig_limits import find_corner_radius_px, find_turning_radius_px

AUTO = "auto"
"""The request that the model be chosen: Brown's, the rational, the fisheye or the tilted one."""
RICHER = ("fisheye", "rational")
"""Models tried beside Brown's, from few to many coefficients."""
ODD_CENTER = 0.025
"""Distance of Brown's principal point from the middle, over the image's width, from which a tilted sensor is tried:
the tilt τ shifts it by f tan τ. Lenses without tilt stay below mostly; 0.025 is 1° with a lens of 40° of view."""
MIN_GAIN = 0.15
"""Least relative decrease of the held-out RMS for another model than Brown's; a board that is bent by 0.1 mm makes
5 % through a normal lens, a lens of 100° that is described by the polynomial 50 %."""
MIN_GAIN_PX = 0.01
"""Least decrease of the held-out RMS, px: smaller ones come from the corners of a few views."""
SIGNIFICANCE = 2.0
"""Standard errors by which the decrease must exceed 0: those over the views or over the folds, the greater ones."""
MIN_CHOICE_VIEWS = 8
"""Least number of views for a comparison: two in every one of four folds."""
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


@dataclass(frozen=True, slots=True)
class _Gain:
    """Decrease of the held-out error from one model to another, over their common views."""

    px: float
    """Difference of the RMS."""
    factor_log: float
    """Mean over the views of the logarithm of the ratio of their RMS."""
    error: float
    """Standard error of ``factor_log``."""

    @property
    def is_clear(self) -> bool:
        """True if the second model is clearly better, by size and by significance."""
        least = max(SIGNIFICANCE * self.error, -float(np.log1p(-MIN_GAIN)))
        return self.px > MIN_GAIN_PX and self.factor_log > least

    def describe(self) -> str:
        return f"{self.px:.3f} px, {100 * self.factor_log:.1f} ± {100 * self.error:.1f} % by view"


def calibrate_with_model(
    name: str,
    detections: BoardDetections,
    board_mm: Array,
    requested: str = AUTO,
    *,
    min_views: int = MIN_VIEWS,
) -> tuple[MonocularCalibration, LensChoice]:
    """Calibrate one camera with the requested lens model, the one stated for it, or the one its views ask for.

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
            brown = calibrate_camera(name, detections, board_mm, min_views=min_views)
        except CalibrationError:
            if requested == "brown" or len(detections.views[name]) < MIN_CHOICE_VIEWS:
                raise
    if requested not in ("brown", AUTO):
        fitted = fit_model(name, detections, board_mm, requested, brown, min_views)
        return fitted, LensChoice(name, requested, "as asked for", {})
    others = _list_others(brown, detections, board_mm) if requested == AUTO else ()
    if brown is not None and not others:
        return brown, LensChoice(name, "brown", "", {})
    return _compare(name, detections, board_mm, brown, others)


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
    if turns_within_image(camera) or predict_gain(brown, detections, board_mm) > 2 * MIN_GAIN:
        return (RICHER[0], *tilted, *RICHER[1:])
    return tilted


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
    errors = {model: hold_out(name, detections, board_mm, fit) for model, fit in fits.items()}
    usable = [model for model in fits if errors[model].squares]
    folded = [model for model in usable if _turns_within_views(fits[model].camera, detections)]
    candidates = [model for model in usable if model not in folded] or usable or list(fits)
    taken = candidates[0]
    for model in candidates[1:]:
        if _compute_gain(errors[taken], errors[model]).is_clear:
            taken = model
    rms = {model: each.rms_px for model, each in errors.items()}
    return fits[taken], LensChoice(name, taken, _describe(taken, fits, errors, folded), rms)


def _turns_within_views(camera: Camera, detections: BoardDetections) -> bool:
    """Return whether the lens model turns back where corners were seen; beyond them it is not known anyway."""
    reach = find_reach_px(camera, detections.views[camera.name])
    return find_turning_radius_px(camera) < TURNING_MARGIN * reach


def _compute_gain(first: HeldOutErrors, second: HeldOutErrors) -> _Gain:
    """Return the decrease of the errors from the first model to the second, the mean over the logarithms by view."""
    common = [frame for frame in first.squares if frame in second.squares]
    if len(common) < MIN_CHOICE_VIEWS:
        return _Gain(0.0, 0.0, float("inf"))
    a, b = (np.array([max(each.squares[f], 1e-12) for f in common]) for each in (first, second))
    gains = 0.5 * np.log(a / b)
    fold = np.array([first.fold[frame] for frame in common])
    means = np.array([gains[fold == number].mean() for number in np.unique(fold)])
    error = max(float(each.std(ddof=1) / np.sqrt(len(each))) for each in (gains, means) if len(each) > 1)
    px = float(np.sqrt(a.mean()) - np.sqrt(b.mean()))
    return _Gain(px, float(gains.mean()), error)


def _describe(
    taken: str,
    fits: Mapping[str, MonocularCalibration],
    errors: Mapping[str, HeldOutErrors],
    folded: Sequence[str],
) -> str:
    """Return why a model was taken, with the figures."""
    others = ", ".join(f"{model} {each.rms_px:.3f}" for model, each in errors.items() if model != taken)
    figures = f"held-out RMS {errors[taken].rms_px:.3f} px" + (f" ({others})" if others else "")
    if "brown" not in fits:
        return f"the polynomial does not fit the views; {figures}"
    if "brown" in folded and taken != "brown":
        turning = find_turning_radius_px(fits["brown"].camera)
        return f"the polynomial turns back {turning:.0f} px from the principal point, among the corners; {figures}"
    if not errors["brown"].squares:
        return f"the polynomial does not fit views that it was not fitted to; {figures}"
    if taken != "brown":
        gain = _compute_gain(errors["brown"], errors[taken]).describe()
        return f"its errors on held-out views are clearly smaller than those of brown ({gain}); {figures}"
    best = min(
        (model for model in fits if model != "brown"), key=lambda model: errors[model].rms_px, default=""
    )
    gain = f" ({best}: {_compute_gain(errors['brown'], errors[best]).describe()})" if best else ""
    return f"no other model is clearly better{gain}; {figures}"
