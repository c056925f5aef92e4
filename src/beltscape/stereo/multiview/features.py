"""The features of a matched surface: what the networks take of every pixel before the candidate selection.

They are planes (H, W) by name, computed from the surface and its fits without NaN, `ConfidenceInputs`. Steps and
distances in px grow with the images. They are given in px of a grid of scale 1, so that the same shape has the same
features at any size.

They are taken from the matcher's state, the results of its stages so far. Those of the core's image (brightness,
contrast and texture) do not depend on the surface.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Floats
from beltscape.kernels.planes import blur, dilate, erode, measure_distances, median_blur, to_single
from beltscape.learned.registry import load_network
from beltscape.stereo.multiview.candidates import Selection
from beltscape.stereo.multiview.frame import PreparedFrame, Windows
from beltscape.stereo.multiview.optimisation import LeastSquaresResult, PropagationResult
from beltscape.stereo.multiview.parallel import collect_parallel, run_pair, run_parallel
from beltscape.stereo.multiview.photometry import (
    compute_box_moments,
    compute_local_variance,
    compute_texture_ratio,
)
from beltscape.stereo.multiview.surface import Surface, compute_visibility, detect_depth_steps, fill_nan

_WIDE_PX = 31
"""Side of the window, several dots wide, with whose brightness and contrast a pixel's own are compared."""
REACH_PX = 9
"""Window around texture in which pixels without texture are measured, since the fit's window includes the texture."""
TEXTURE, TEXTURE_PX = 2.0, 9
"""Ratio of the variance to the noise's up to which a window has no texture, and its side in px at scale 1."""


class ImageFeatures(NamedTuple):
    """Features of the pixels of the core's image, and where it has texture."""

    planes: dict[str, Floats]
    """(H, W) features by name."""
    textured: NDArray[np.bool_]
    """(H, W) pixels inside the image near which there is texture."""


def compute_image_features(prepared: PreparedFrame) -> ImageFeatures:
    """Return the features of the core's image, and where it has texture."""
    kernels = prepared.context.kernels
    found, textured = kernels.replay(_compare_all, prepared)
    return ImageFeatures({name: kernels.keep(plane) for name, plane in found.items()}, textured)


def _compare_all(prepared: PreparedFrame) -> ImageFeatures:
    return ImageFeatures(dict(_compare_with_neighbourhood(prepared)), _mask_textured(prepared))


def _compare_with_neighbourhood(prepared: PreparedFrame) -> Iterator[tuple[str, Floats]]:
    """Yield brightness and contrast relative to the surroundings: both are lower outside the projector's light."""
    boxes = prepared.context.windows.boxes
    core = np.maximum(prepared.filled_core, 0)  # splines undershoot
    noise = to_single(prepared.noise.levels)
    wide_mean, wide_variance = compute_box_moments(core, boxes[_WIDE_PX])
    brightness, contrast = wide_mean + 1, wide_variance + noise
    for window_px in (5, 11):
        mean, variance = compute_box_moments(core, boxes[window_px])
        yield f"relative brightness within {window_px}", np.log((mean + 1) / brightness)
        yield f"relative contrast within {window_px}", np.log((variance + noise) / contrast)
    yield "log texture over noise", np.log((compute_local_variance(core) + np.float32(1e-3)) / noise)


def _mask_textured(prepared: PreparedFrame) -> NDArray[np.bool_]:
    """Return the mask (H, W) of pixels within `REACH_PX` of texture."""
    side = prepared.context.windows.boxes[TEXTURE_PX][0]
    texture = compute_texture_ratio(prepared.filled_core, prepared.noise.levels, side)
    return dilate(texture, (REACH_PX, REACH_PX)) > TEXTURE


@dataclass(frozen=True, slots=True, eq=False)
class MatcherState:
    """The results of the stages on the matcher's grid."""

    prepared: PreparedFrame
    propagated: PropagationResult
    """Result of the last round of propagation."""
    solution: LeastSquaresResult
    image_features: dict[str, NDArray[np.floating]]
    """(H, W) by name: the features of the core's image."""
    textured: NDArray[np.bool_]
    """(H, W) pixels near which the core's image has texture."""
    filled: NDArray[np.bool_]
    """(H, W) textureless discs whose surface is continued from their rims."""
    selection: Selection | None
    """Result of the candidate selection; None without one."""


Features = Iterator[tuple[str, Floats]]
"""Planes (H, W) by name."""

_MOST_LOGIT = 8.0
"""Limit of the initial confidence's logit, a probability of 0.9997."""
_MOST_STEP_PX = 30.0
"""Limit of the height of a step."""
_MOST_OFFSET_PX = 5.0
"""Limit of a pixel's distance from the median of its neighbours."""


@dataclass(frozen=True, slots=True, eq=False)
class ConfidenceInputs:
    """Planes (H, W) from which the features of a surface are computed; without NaN unless stated."""

    prepared: PreparedFrame
    image_features: dict[str, NDArray[np.floating]]
    """By name: the features of the core's image."""
    surface: Surface
    """As matched, with NaN where there is none."""
    filled: Surface
    """The surface with 0 in place of NaN, as in all planes below unless stated."""
    propagated_s: NDArray[np.float32]
    """Inverse depth before the last iterations of least squares."""
    depth_steps: NDArray[np.bool_]
    """Pixels beside depth steps."""
    visible: NDArray[np.uint8]
    """Number of auxiliaries that see the surface."""
    buffers: list[NDArray[np.floating]]
    """n of (h, w): the auxiliaries' inverse-depth buffers of the surface."""
    agreeing: NDArray[np.uint8]
    """Number of auxiliaries that agree with the core."""
    cost: NDArray[np.float32]
    """Dissimilarity of the images, 0..1, with 1 in place of NaN."""
    margin: NDArray[np.float32]
    """Difference to the cost of the next candidate."""
    information: NDArray[np.float32]
    """Of the pixel alone, 1/px²."""
    variance: NDArray[np.float32]
    """Of s, px²; NaN where the fit has none."""
    filled_variance: NDArray[np.float32]
    """The variance with 1 in place of NaN."""
    disagreement: NDArray[np.float32]
    """Between the windows of the fit, in units of the smaller one's variance."""

    @classmethod
    def from_state(cls, state: MatcherState) -> ConfidenceInputs:
        """Return the inputs for the matcher's surface."""
        prepared, context = state.prepared, state.prepared.context
        surface, solution, propagated = state.solution.surface, state.solution, state.propagated
        zero_for_nan = (
            surface.s, surface.slope_u, surface.slope_v, propagated.surface.s, propagated.margin,
            solution.information, solution.disagreement,
        )  # fmt: skip
        jobs = [partial(fill_nan, plane) for plane in zero_for_nan]
        jobs += [partial(fill_nan, plane, 1.0) for plane in (propagated.cost, solution.variance)]
        (
            s, slope_u, slope_v, propagated_s, margin, information, disagreement, cost, filled_variance,
        ) = run_parallel(jobs, context.threads)  # fmt: skip
        (visible, buffers), depth_steps = run_pair(
            lambda: compute_visibility(
                surface.s, prepared.views, prepared.sizes, context.kernels, context.threads
            ),
            lambda: detect_depth_steps(s),
            context.threads,
        )
        return cls(
            prepared, state.image_features, surface, Surface(s, slope_u, slope_v), propagated_s, depth_steps,
            visible, buffers, solution.used, cost, margin, information, solution.variance, filled_variance,
            disagreement,
        )  # fmt: skip

    @property
    def windows(self) -> Windows:
        """Window sizes of the grid."""
        return self.prepared.context.windows

    @property
    def auxiliaries(self) -> int:
        """Number of auxiliaries."""
        return len(self.prepared.images)


def compute_initial_features(inputs: ConfidenceInputs) -> dict[str, Floats]:
    """Return the features before candidate selection."""
    of_surface = (
        compute_shape_features,
        compute_slope_deviations,
        compute_relief_features,
        compute_agreement_features,
    )
    parts = [partial(compute, inputs) for compute in of_surface]
    return collect_parallel(parts, inputs.prepared.context.threads) | inputs.image_features


def compute_selection_features(inputs: ConfidenceInputs) -> dict[str, Floats]:
    """Return the initial features with the initial confidence, its means and its minimum around."""
    features, context = compute_initial_features(inputs), inputs.prepared.context
    network = load_network("initial_confidence")
    (logit,) = network.evaluate(features, context.kernels, context.threads)
    return features | dict(compute_initial_confidence_features(logit, context.windows))


def limit_confidence(logit: Floats) -> NDArray[np.float32]:
    """Return the initial confidence (H, W), logit, within ±`_MOST_LOGIT`."""
    return np.clip(logit, -_MOST_LOGIT, _MOST_LOGIT).astype(np.float32, copy=False)


def compute_initial_confidence_features(logit: Floats, windows: Windows) -> Features:
    """Yield the initial confidence (H, W), logit, its means and its minimum around."""
    logit = limit_confidence(logit)
    yield "initial confidence", logit
    for window_px in (3, 7, 15):
        yield f"initial confidence within {window_px}", blur(logit, windows.boxes[window_px])
    yield "lowest initial confidence within 3", erode(logit, windows.boxes[3])


def compute_shape_features(inputs: ConfidenceInputs) -> Features:
    """Yield the shape of the surface: steps, slopes and bends."""
    s, surface = inputs.filled.s, inputs.filled
    px = np.float32(1 / inputs.windows.scale)
    offset = _compute_difference(s, median_blur(s))
    offset *= px
    yield "offset from median", _limit(offset, _MOST_OFFSET_PX)
    behind_step = -px * _compute_step_distance(inputs.depth_steps)
    yield "step proximity", np.exp(behind_step)
    yield "wide step proximity", np.exp(behind_step / 4)
    # NumPy has no vector instructions for `hypot`; slopes are too small for a square to overflow
    yield "slope", _limit(np.sqrt(np.square(surface.slope_u) + np.square(surface.slope_v)), 2)
    yield from _compute_bend_features(inputs)


def compute_agreement_features(inputs: ConfidenceInputs) -> Features:
    """Yield how well the images agree on the surface: variance, views, cost, margin and information."""
    yield "log sigma", 0.5 * _take_log(np.clip(inputs.variance, 1e-6, 4.0))
    yield from _compute_view_features(inputs)
    yield "cost", inputs.cost
    yield "mean cost", blur(inputs.cost, (7, 7))
    yield "margin", inputs.margin
    yield "small margin", np.minimum(inputs.margin, 0.15)
    information = blur(inputs.information, inputs.windows.boxes[5])
    yield "log grid scale", np.full_like(information, np.log(inputs.windows.scale))
    yield "log mean information", _take_log(np.maximum(information, 0) + np.float32(1e-3))


def _compute_view_features(inputs: ConfidenceInputs) -> Features:
    visible, number, auxiliaries = inputs.visible, inputs.visible.astype(np.float32), inputs.auxiliaries
    yield "one view", (visible == 1).astype(np.float32)
    yield "two views", (visible == 2).astype(np.float32)
    yield "share of views", number / auxiliaries
    yield "mean views", blur(np.minimum(number, 4), (9, 9))
    yield "no agreeing view", (inputs.agreeing == 0).astype(np.float32)
    disagreeing = np.maximum(visible, inputs.agreeing) - inputs.agreeing  # 0 where more agree than see it
    yield "share of disagreeing views", disagreeing.astype(np.float32) / auxiliaries


def _compute_bend_features(inputs: ConfidenceInputs) -> Features:
    """Yield the logarithm of the mean distance, px, of s from its window mean; it is small on planes."""
    s = inputs.filled.s
    for name, window_px, least in (("bend", 7, 0.001), ("wide bend", 25, 0.004)):
        box = inputs.windows.boxes[window_px]
        offset = _limit(_compute_difference(s, blur(s, box)), 1)
        yield name, _take_log(blur(offset, box) + np.float32(least))


def compute_slope_deviations(inputs: ConfidenceInputs) -> Features:
    """Yield the logarithm of the slopes' standard deviation in a window: large at edges and on round flanks."""
    slopes = [np.clip(slope, -3, 3) for slope in (inputs.filled.slope_u, inputs.filled.slope_v)]
    for name, window_px in (("slope deviation", 5), ("wide slope deviation", 15)):
        box = inputs.windows.boxes[window_px]
        (_, across), (_, down) = (compute_box_moments(slope, box) for slope in slopes)
        yield name, 0.5 * _take_log(across + down + np.float32(1e-8))


def compute_relief_features(inputs: ConfidenceInputs) -> Features:
    """Yield the last update, and how much nearer and farther the surface is around a pixel: what may occlude it."""
    s, px = inputs.filled.s, np.float32(1 / inputs.windows.scale)
    update = _limit(np.abs(s - inputs.propagated_s), 2)
    yield "last update", _take_log(blur(update, inputs.windows.boxes[5]) + np.float32(0.002))
    for window_px in (5, 11, 21):
        square = inputs.windows.boxes[window_px]
        yield f"nearer within {window_px}", _limit(px * (dilate(s, square) - s), _MOST_STEP_PX)
        yield f"farther within {window_px}", _limit(px * (s - erode(s, square)), _MOST_STEP_PX)


def _compute_step_distance(depth_steps: NDArray[np.bool_]) -> Floats:
    """Return the (H, W) distance to the nearest depth step of the surface, px."""
    # without any step OpenCV returns nearly the largest number
    return np.minimum(measure_distances(depth_steps), 1e4)


def _compute_difference(s: Floats, other: Floats) -> Floats:
    """Return the absolute difference, which overwrites the other plane: a new one costs as much as computing it."""
    return np.abs(np.subtract(s, other, out=other), out=other)


def _limit(plane: Floats, most: float) -> Floats:
    """Return the plane with its values limited in place."""
    return np.minimum(plane, most, out=plane)


def _take_log(plane: Floats) -> Floats:
    """Return the logarithm of the plane, taken in place."""
    return np.log(plane, out=plane)
