"""What to believe of a surface: sigma, confidence and the number of views, pixel by pixel."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels
from beltscape.stereo.belief import fitted
from beltscape.stereo.evidence import evidence
from beltscape.stereo.levels import local_variance
from beltscape.stereo.prepared import PreparedFrame
from beltscape.stereo.propagate import Propagated
from beltscape.stereo.refine import Refined
from beltscape.stereo.sight import seen_by

Array = NDArray[np.floating]

REACH_PX = 9
"""A flat pixel may be held by texture so far away that its fit's window still touches it."""
CONTRADICTION = 0.4
"""Mean dissimilarity from which on views that do not agree contradict the surface."""


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

    Both are a small network's answers to what `evidence` lists, fitted to simulated frames with known truth
    (docs/matching.md): confidence to what is right, sigma to the median error.
    """
    seen = seen_by(refined.surface.s, prepared.views, prepared.sizes, kernels, threads)
    belief, found = fitted(), dict(evidence(chosen, refined, prepared, seen, scale))
    logit, log_sigma = kernels.perceptron(
        [found[name] for name in belief.names], belief.limits, belief.hidden, belief.output, threads=threads
    )
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
