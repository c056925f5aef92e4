"""What to believe of a surface: sigma, confidence and the number of views, pixel by pixel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels
from beltscape.stereo.levels import local_variance
from beltscape.stereo.prepared import PreparedFrame
from beltscape.stereo.propagate import Propagated
from beltscape.stereo.refine import Refined
from beltscape.stereo.sight import seen_by
from beltscape.stereo.surface import steps

Array = NDArray[np.floating]

STEP_PX = 2.5
"""A range of s within 5 × 5 pixels from which on it is a depth step."""
REACH_PX = 9
"""A flat pixel may be held by texture so far away that its fit's window still touches it."""
CONTRADICTION = 0.4
"""Mean dissimilarity from which on views that do not agree contradict the surface."""
WEIGHTS: dict[str, float] = {
    "constant": -0.191,
    "log sigma": -0.909,
    "log sigma squared": 0.145,
    "one view": -0.759,
    "two views": -0.599,
    "share of views": -1.528,
    "none agrees": -0.457,
    "disagreeing": 0.477,
    "cost": 0.548,
    "cost around": -2.895,
    "margin": 1.23,
    "some margin": -2.489,
    "few views, log sigma": -0.155,
    "off its neighbours": -0.027,
    "at a step": 0.977,
    "near a step": -2.102,
    "steepness": 1.057,
    "noise over texture": -6.64,
    "mostly noise": -0.352,
    "bend": -0.749,
    "wide bend": -2.555,
}
"""Of the evidence in the logit of the confidence."""
SIGMA_WEIGHTS: dict[str, float] = {
    "constant": 1.716,
    "log sigma": 0.867,
    "bend": 0.317,
    "wide bend": 0.182,
    "cost around": 0.766,
    "near a step": -1.268,
    "steepness": 1.358,
}
"""Of the evidence in the logarithm of sigma."""


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """Per pixel of the matcher's grid."""

    sigma: Array
    """(H, W) one standard deviation of s, px."""
    confidence: Array
    """(H, W) probability that the pixel is not a false surface."""
    views: NDArray[np.uint8]
    """(H, W) auxiliaries that see the pixel."""


def judge(
    chosen: Propagated,
    refined: Refined,
    prepared: PreparedFrame,
    scale: float,
    kernels: Kernels,
    threads: int,
) -> Verdict:
    """Sigma and confidence of a refined surface, on a grid ``scale`` times finer than `windows` tells sizes for.

    Confidence is a logistic function, sigma an exponential one of what `evidence` lists; both were fitted to
    simulated frames with known truth (docs/matching.md), sigma to the median error.
    """
    seen = seen_by(refined.surface.s, prepared.views, prepared.sizes, kernels, threads)
    logit, log_sigma = np.zeros_like(refined.surface.s), np.zeros_like(refined.surface.s)
    for name, value in evidence(chosen, refined, prepared, seen, scale):
        logit += np.float32(WEIGHTS.get(name, 0)) * value
        log_sigma += np.float32(SIGMA_WEIGHTS.get(name, 0)) * value
    confidence = 1 / (1 + np.exp(-logit))
    trusted = np.isfinite(refined.surface.s) & (seen > 0) & _told(chosen, refined, prepared)
    return Verdict(
        sigma=np.exp(log_sigma),
        confidence=np.where(trusted, confidence, 0).astype(np.float32),
        views=np.where(trusted, seen, 0).astype(np.uint8),
    )


def _told(chosen: Propagated, refined: Refined, prepared: PreparedFrame) -> NDArray[np.bool_]:
    """(H, W) where the images say anything at all: texture above the noise, and not that nothing fits."""
    core = np.nan_to_num(prepared.core)
    texture = cv2.dilate(local_variance(core), np.ones((REACH_PX, REACH_PX), np.uint8))
    contradicted = (refined.used == 0) & (
        cv2.blur(np.nan_to_num(chosen.cost, nan=1.0), (7, 7)) > CONTRADICTION
    )
    return np.isfinite(prepared.core) & (texture > prepared.noise.levels) & ~contradicted


def evidence(
    chosen: Propagated, refined: Refined, prepared: PreparedFrame, seen: NDArray[np.uint8], scale: float
) -> Iterator[tuple[str, Array]]:
    """What speaks for and against a pixel, by name."""
    surface, auxiliaries = refined.surface, len(prepared.images)
    s = np.nan_to_num(surface.s).astype(np.float32)
    yield "constant", np.ones_like(s)
    log_sigma = 0.5 * np.log(np.clip(refined.variance, 1e-6, 4.0))
    yield "log sigma", log_sigma
    yield "log sigma squared", log_sigma * log_sigma
    yield "one view", (seen == 1).astype(np.float32)
    yield "two views", (seen == 2).astype(np.float32)
    yield "share of views", seen.astype(np.float32) / auxiliaries
    yield "none agrees", (refined.used == 0).astype(np.float32)
    yield "disagreeing", np.maximum(seen.astype(np.float32) - refined.used, 0) / auxiliaries
    cost = np.nan_to_num(chosen.cost, nan=1.0)
    yield "cost", cost
    yield "cost around", np.asarray(cv2.blur(cost, (7, 7)), np.float32)
    margin = np.nan_to_num(chosen.margin)
    yield "margin", margin
    yield "some margin", np.minimum(margin, 0.15)
    yield "few views, log sigma", (seen <= 2) * log_sigma
    yield "off its neighbours", np.minimum(np.abs(s - cv2.medianBlur(s, 5)), 5)
    to_step = _to_step(s)
    yield "at a step", np.exp(-to_step)
    yield "near a step", np.exp(-to_step / 4)
    yield "steepness", np.nan_to_num(np.minimum(np.hypot(surface.slope_u, surface.slope_v), 2))
    weakness = np.float32(prepared.noise.levels) / (local_variance(np.nan_to_num(prepared.core)) + 1e-3)
    yield "noise over texture", np.minimum(weakness, 1)
    yield "mostly noise", np.clip(4 * weakness - 1, 0, 1)
    yield from roughness(s, scale)


def roughness(s: Array, scale: float) -> Iterator[tuple[str, Array]]:
    """What a surface's own shape says of its errors, by name: on planes large windows have smoothed nothing away.

    Each is the logarithm of how far s lies off its mean over a window, averaged over the same window, px; windows
    grow with ``scale``.
    """
    for name, window_px, least in (("bend", 7, 0.001), ("wide bend", 25, 0.004)):
        side = 2 * int(window_px * scale / 2) + 1
        off = np.minimum(np.abs(s - cv2.blur(s, (side, side))), 1)
        yield name, np.log(cv2.blur(off, (side, side)) + np.float32(least))


def _to_step(s: Array) -> Array:
    """(H, W) distance to the nearest depth step of the surface itself, px."""
    step = steps(s, STEP_PX)
    return np.asarray(cv2.distanceTransform((~step).astype(np.uint8), cv2.DIST_L2, 5), np.float32)
