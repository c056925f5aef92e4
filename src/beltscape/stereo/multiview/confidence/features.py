"""Initial features of the pixels of a matched surface: image, agreement and shape, as planes by name."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.frame.nan import fill_nan
from beltscape.stereo.multiview.frame.photometry import compute_local_variance
from beltscape.stereo.multiview.frame.surface import Surface, detect_depth_steps
from beltscape.stereo.multiview.frame.windows import scale_window
from beltscape.stereo.multiview.optimisation.least_squares import LeastSquaresResult
from beltscape.stereo.multiview.optimisation.propagation import PropagationResult

Array = NDArray[np.floating]

_WIDE_PX = 31
"""Side of the window, several dots wide, with whose brightness and contrast a pixel's own are compared."""
_MOST_STEP_PX = 30.0
"""Limit of the height of a step."""
_MOST_OFFSET_PX = 5.0
"""Limit of a pixel's distance from the median of its neighbours."""


def compute_agreement_features(
    propagated: PropagationResult, solution: LeastSquaresResult, visible: NDArray[np.uint8], auxiliaries: int
) -> Iterator[tuple[str, Array]]:
    """Yield how well the images agree on the surface, planes (H, W) by name.

    ``visible`` (H, W) is the number of the ``auxiliaries`` that see the surface.
    """
    yield "log sigma", 0.5 * np.log(np.clip(solution.variance, 1e-6, 4.0))
    yield from _compute_view_features(solution, visible, auxiliaries)
    cost, margin = fill_nan(propagated.cost, 1.0), fill_nan(propagated.margin)
    yield "cost", cost
    yield "mean cost", np.asarray(cv2.blur(cost, (7, 7)), np.float32)
    yield "margin", margin
    yield "small margin", np.minimum(margin, 0.15)


def compute_information_features(solution: LeastSquaresResult, scale: float) -> Iterator[tuple[str, Array]]:
    """Yield the scale of the grid, and the information of the least squares around each pixel (H, W), by name."""
    information = cv2.blur(fill_nan(solution.information), scale_window(5, scale))
    yield "log grid scale", np.full(information.shape, np.log(scale), np.float32)
    yield "log mean information", np.log(np.maximum(information, 0) + np.float32(1e-3))


def compute_shape_features(
    propagated: PropagationResult, solution: LeastSquaresResult, scale: float
) -> Iterator[tuple[str, Array]]:
    """Yield the shape of the surface, planes (H, W) by name; NaN of the surface counts as 0.

    Steps and distances in px grow with the images. They are given in px of a grid of scale 1, so that the same shape
    has the same features at any size.
    """
    surface = solution.surface
    s = fill_nan(surface.s)
    px = np.float32(1 / scale)
    yield "offset from median", np.minimum(px * np.abs(s - cv2.medianBlur(s, 5)), _MOST_OFFSET_PX)
    step_distance = px * _compute_step_distance(s)
    yield "step proximity", np.exp(-step_distance)
    yield "wide step proximity", np.exp(-step_distance / 4)
    yield "slope", fill_nan(np.minimum(np.hypot(surface.slope_u, surface.slope_v), 2))
    yield from _compute_bend_features(s, scale)
    yield from _compute_slope_deviations(surface, scale)
    yield "last update", _compute_last_update(propagated, s, scale)
    yield from _compute_relief_features(s, scale)


def _compute_view_features(
    solution: LeastSquaresResult, visible: NDArray[np.uint8], auxiliaries: int
) -> Iterator[tuple[str, Array]]:
    number = visible.astype(np.float32)
    yield "one view", (visible == 1).astype(np.float32)
    yield "two views", (visible == 2).astype(np.float32)
    yield "share of views", number / auxiliaries
    yield "mean views", np.asarray(cv2.blur(np.minimum(number, 4), (9, 9)), np.float32)
    yield "no agreeing view", (solution.used == 0).astype(np.float32)
    yield "share of disagreeing views", np.maximum(number - solution.used, 0) / auxiliaries


def _compute_bend_features(s: Array, scale: float) -> Iterator[tuple[str, Array]]:
    """Yield the logarithm of the mean distance, px, of s from its window mean; it is small on planes."""
    for name, window_px, least in (("bend", 7, 0.001), ("wide bend", 25, 0.004)):
        side = scale_window(window_px, scale)
        offset = np.minimum(np.abs(s - cv2.blur(s, side)), 1)
        yield name, np.log(cv2.blur(offset, side) + np.float32(least))


def _compute_slope_deviations(surface: Surface, scale: float) -> Iterator[tuple[str, Array]]:
    """Yield the logarithm of the slopes' standard deviation in a window: large at edges and on round flanks."""
    slopes = [np.clip(fill_nan(slope), -3, 3) for slope in (surface.slope_u, surface.slope_v)]
    for name, window_px in (("slope deviation", 5), ("wide slope deviation", 15)):
        side = scale_window(window_px, scale)
        variance = _compute_variance(slopes[0], side) + _compute_variance(slopes[1], side)
        yield name, 0.5 * np.log(variance + np.float32(1e-8))


def _compute_last_update(propagated: PropagationResult, s: Array, scale: float) -> Array:
    """Return the (H, W) logarithm of the mean change of s by the last iterations, px, over a window."""
    before = fill_nan(propagated.surface.s)
    return np.log(cv2.blur(np.minimum(np.abs(s - before), 2), scale_window(5, scale)) + np.float32(0.002))


def _compute_relief_features(s: Array, scale: float) -> Iterator[tuple[str, Array]]:
    """Yield how much nearer and farther the surface is around a pixel: what may occlude it or be occluded by it."""
    px = np.float32(1 / scale)
    for window_px in (5, 11, 21):
        square = np.ones(scale_window(window_px, scale), np.uint8)
        yield f"nearer within {window_px}", np.minimum(px * (cv2.dilate(s, square) - s), _MOST_STEP_PX)
        yield f"farther within {window_px}", np.minimum(px * (s - cv2.erode(s, square)), _MOST_STEP_PX)


def compute_image_features(prepared: PreparedFrame) -> Iterator[tuple[str, Array]]:
    """Yield brightness and contrast relative to the surroundings: both are lower outside the projector's light."""
    scale = prepared.context.scale
    core = np.maximum(fill_nan(prepared.core), 0)  # splines undershoot
    noise = np.float32(prepared.noise.levels)
    wide = scale_window(_WIDE_PX, scale)
    mean, contrast = cv2.blur(core, wide) + 1, _compute_variance(core, wide) + noise
    for window_px in (5, 11):
        side = scale_window(window_px, scale)
        yield f"relative brightness within {window_px}", np.log((cv2.blur(core, side) + 1) / mean)
        yield (
            f"relative contrast within {window_px}",
            np.log((_compute_variance(core, side) + noise) / contrast),
        )
    yield "log texture over noise", np.log((compute_local_variance(core) + np.float32(1e-3)) / noise)


def _compute_variance(image: Array, side: tuple[int, int]) -> Array:
    """Return the (H, W) variance within a window."""
    mean = cv2.blur(image, side)
    return np.maximum(cv2.blur(image * image, side) - mean * mean, 0)


def _compute_step_distance(s: Array) -> Array:
    """Return the (H, W) distance to the nearest depth step of the surface, px."""
    step = detect_depth_steps(s)
    distance = cv2.distanceTransform((~step).astype(np.uint8), cv2.DIST_L2, 5)
    return np.minimum(
        np.asarray(distance, np.float32), 1e4
    )  # without any step OpenCV returns nearly the largest number
