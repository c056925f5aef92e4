"""What speaks for and against a pixel of a matched surface: planes of evidence, by name."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.frame.nan import fill_nan
from beltscape.stereo.multiview.frame.photometry import local_variance
from beltscape.stereo.multiview.frame.surface import Surface, detect_depth_steps
from beltscape.stereo.multiview.frame.windows import scaled_window
from beltscape.stereo.multiview.optimisation.least_squares import RefinementResult
from beltscape.stereo.multiview.optimisation.propagation import PropagationResult

Array = NDArray[np.floating]

_WIDE_PX = 31
"""Side of the window with whose light a pixel's own is compared: several dots wide."""
_MOST_PX = 30.0
"""A step counts as no higher than that, ..."""
_MOST_OFF_PX = 5.0
"""... and a pixel as no farther off its neighbours."""


def agreement_features(
    chosen: PropagationResult,
    refined: RefinementResult,
    auxiliaries: int,
    seen: NDArray[np.uint8],
    scale: float,
) -> Iterator[tuple[str, Array]]:
    """What the images say of the surface, planes (H, W) by name; windows grow with ``scale``.

    ``seen`` (H, W) is how many auxiliaries see the surface.
    """
    yield "log sigma", 0.5 * np.log(np.clip(refined.variance, 1e-6, 4.0))
    yield from _views(refined, seen, auxiliaries)
    cost, margin = fill_nan(chosen.cost, 1.0), fill_nan(chosen.margin)
    yield "cost", cost
    yield "cost around", np.asarray(cv2.blur(cost, (7, 7)), np.float32)
    yield "margin", margin
    yield "some margin", np.minimum(margin, 0.15)
    information = cv2.blur(fill_nan(refined.information), scaled_window(5, scale))
    yield "size", np.full_like(cost, np.log(scale))
    yield "information around", np.log(np.maximum(information, 0) + np.float32(1e-3))


def shape_features(
    chosen: PropagationResult, refined: RefinementResult, scale: float
) -> Iterator[tuple[str, Array]]:
    """What the surface's own shape says, planes (H, W) by name; NaN of the surface counts as 0.

    A shape's steps and distances in px grow with the images; they are told in px of a grid of scale 1, so that the
    same shape gives the same evidence at any size.
    """
    surface = refined.surface
    s = fill_nan(surface.s)
    px = np.float32(1 / scale)
    yield "off its neighbours", np.minimum(px * np.abs(s - cv2.medianBlur(s, 5)), _MOST_OFF_PX)
    to_step = px * _to_step(s)
    yield "at a step", np.exp(-to_step)
    yield "near a step", np.exp(-to_step / 4)
    yield "steepness", fill_nan(np.minimum(np.hypot(surface.slope_u, surface.slope_v), 2))
    yield from _roughness(s, scale)
    yield from _turning(surface, scale)
    yield "moved", _moved(chosen, s, scale)
    yield from _relief(s, scale)


def _views(
    refined: RefinementResult, seen: NDArray[np.uint8], auxiliaries: int
) -> Iterator[tuple[str, Array]]:
    number = seen.astype(np.float32)
    yield "one view", (seen == 1).astype(np.float32)
    yield "two views", (seen == 2).astype(np.float32)
    yield "share of views", number / auxiliaries
    yield "views around", np.asarray(cv2.blur(np.minimum(number, 4), (9, 9)), np.float32)
    yield "none agrees", (refined.used == 0).astype(np.float32)
    yield "disagreeing", np.maximum(number - refined.used, 0) / auxiliaries


def _roughness(s: Array, scale: float) -> Iterator[tuple[str, Array]]:
    """What a surface's own shape says of its errors: on planes large windows have smoothed nothing away.

    Each is the logarithm of how far s lies off its mean over a window, averaged over the same window, px.
    """
    for name, window_px, least in (("bend", 7, 0.001), ("wide bend", 25, 0.004)):
        side = scaled_window(window_px, scale)
        off = np.minimum(np.abs(s - cv2.blur(s, side)), 1)
        yield name, np.log(cv2.blur(off, side) + np.float32(least))


def _turning(surface: Surface, scale: float) -> Iterator[tuple[str, Array]]:
    """By how much the fitted planes differ about a pixel: facets and tops are even, edges and round flanks not.

    Each is the logarithm of the slopes' standard deviation in a window.
    """
    slopes = [np.clip(fill_nan(slope), -3, 3) for slope in (surface.slope_u, surface.slope_v)]
    for name, window_px in (("turn", 5), ("wide turn", 15)):
        side = scaled_window(window_px, scale)
        yield name, 0.5 * np.log(_spread(slopes[0], side) + _spread(slopes[1], side) + np.float32(1e-8))


def _moved(chosen: PropagationResult, s: Array, scale: float) -> Array:
    """(H, W) logarithm of how far the last iterations still moved the surface, px, averaged over a window."""
    before = fill_nan(chosen.surface.s)
    return np.log(cv2.blur(np.minimum(np.abs(s - before), 2), scaled_window(5, scale)) + np.float32(0.002))


def _relief(s: Array, scale: float) -> Iterator[tuple[str, Array]]:
    """How much nearer and farther the surface comes about a pixel: what may hide it, what it may hide."""
    px = np.float32(1 / scale)
    for window_px in (5, 11, 21):
        square = np.ones(scaled_window(window_px, scale), np.uint8)
        yield f"nearer within {window_px}", np.minimum(px * (cv2.dilate(s, square) - s), _MOST_PX)
        yield f"farther within {window_px}", np.minimum(px * (s - cv2.erode(s, square)), _MOST_PX)


def image_features(prepared: PreparedFrame, scale: float) -> Iterator[tuple[str, Array]]:
    """Is the projector's light here? A shadow is darker and has less contrast than the dots around it."""
    core = np.maximum(fill_nan(prepared.core), 0)  # splines undershoot
    noise = np.float32(prepared.noise.levels)
    wide = scaled_window(_WIDE_PX, scale)
    mean, contrast = cv2.blur(core, wide) + 1, _spread(core, wide) + noise
    for window_px in (5, 11):
        side = scaled_window(window_px, scale)
        yield f"light within {window_px}", np.log((cv2.blur(core, side) + 1) / mean)
        yield f"contrast within {window_px}", np.log((_spread(core, side) + noise) / contrast)
    yield "texture over noise", np.log((local_variance(core) + np.float32(1e-3)) / noise)


def _spread(image: Array, side: tuple[int, int]) -> Array:
    """(H, W) variance within a window."""
    mean = cv2.blur(image, side)
    return np.maximum(cv2.blur(image * image, side) - mean * mean, 0)


def _to_step(s: Array) -> Array:
    """(H, W) distance to the nearest depth step of the surface itself, px."""
    step = detect_depth_steps(s)
    distance = cv2.distanceTransform((~step).astype(np.uint8), cv2.DIST_L2, 5)
    return np.minimum(
        np.asarray(distance, np.float32), 1e4
    )  # without any step it is a number near the largest
