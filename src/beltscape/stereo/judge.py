"""What to believe of a surface: sigma, confidence and the number of views, pixel by pixel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels
from beltscape.stereo.prepared import PreparedFrame
from beltscape.stereo.propagate import OCCLUDER_PX, Propagated
from beltscape.stereo.refine import Refined

Array = NDArray[np.float32]

STEP_PX = 2.5
"""A range of s within 5 × 5 pixels from which on it is a depth step."""
WEIGHTS: dict[str, float] = {
    "constant": 0.0,
}


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """Per pixel of the matcher's grid."""

    sigma: Array
    """(H, W) one standard deviation of s, px."""
    confidence: Array
    """(H, W) probability that the pixel is not a false surface."""
    views: NDArray[np.uint8]
    """(H, W) auxiliaries that see the pixel and agree."""


def judge(
    chosen: Propagated, refined: Refined, prepared: PreparedFrame, kernels: Kernels, threads: int
) -> Verdict:
    """Sigma and confidence of a refined surface.

    Confidence is a logistic function of what `evidence` lists, fitted to simulated frames with known truth.
    """
    seen = _seen(refined.surface.s, prepared, kernels, threads)
    logit = np.zeros_like(refined.surface.s)
    for name, value in evidence(chosen, refined, seen, len(prepared.images)):
        logit += np.float32(WEIGHTS[name]) * value
    confidence = 1 / (1 + np.exp(-logit))
    trusted = np.isfinite(refined.surface.s) & np.isfinite(prepared.core) & (seen > 0)
    return Verdict(
        sigma=_sigma(refined),
        confidence=np.where(trusted, confidence, 0).astype(np.float32),
        views=np.minimum(seen, refined.used),
    )


def _seen(s: Array, prepared: PreparedFrame, kernels: Kernels, threads: int) -> NDArray[np.uint8]:
    """(H, W) how many auxiliaries see the surface: inside their image, nothing in front."""
    sizes = [image.shape[::-1] for image in prepared.images]
    buffers = kernels.nearness_buffers(s, prepared.views, sizes, threads=threads)
    seen = np.zeros(s.shape, np.uint8)
    for view, buffer in zip(prepared.views, buffers, strict=True):
        seen += kernels.visible(s, view, buffer, OCCLUDER_PX, threads=threads)
    return seen


def evidence(
    chosen: Propagated, refined: Refined, seen: NDArray[np.uint8], auxiliaries: int
) -> Iterator[tuple[str, Array]]:
    """What speaks for and against a pixel, by name."""
    surface = refined.surface
    s = np.nan_to_num(surface.s)
    yield "constant", np.ones_like(s)
    log_sigma = 0.5 * np.log(np.clip(refined.variance, 1e-6, 4.0))
    yield "log sigma", log_sigma
    yield "log sigma squared", log_sigma * log_sigma
    yield "one view", (seen == 1).astype(np.float32)
    yield "two views", (seen == 2).astype(np.float32)
    yield "share of views", seen.astype(np.float32) / auxiliaries
    yield "cost around", cv2.blur(np.minimum(chosen.cost, 1), (7, 7))
    yield "margin", np.minimum(chosen.margin, 4)
    yield "clear margin", np.minimum(chosen.margin, 1)
    yield "off its neighbours", np.minimum(np.abs(s - cv2.medianBlur(s, 5)), 5)
    to_step = _to_step(s)
    yield "at a step", np.exp(-to_step)
    yield "near a step", np.exp(-to_step / 4)
    yield "steepness", np.minimum(np.hypot(surface.slope_u, surface.slope_v), 2)


def _to_step(s: Array) -> Array:
    """(H, W) distance to the nearest depth step of the surface itself, px."""
    window = np.ones((5, 5), np.uint8)
    step = cv2.dilate(s, window) - cv2.erode(s, window) > STEP_PX
    return np.asarray(cv2.distanceTransform((~step).astype(np.uint8), cv2.DIST_L2, 5), np.float32)


def _sigma(refined: Refined) -> Array:
    return np.sqrt(refined.variance)
