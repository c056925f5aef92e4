"""The final estimate of a surface: inverse depth, sigma, confidence and number of views of every pixel."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.learned.registry import load_network
from beltscape.stereo.multiview.confidence.correlated_noise import inflate_sigma
from beltscape.stereo.multiview.confidence.features import compute_initial_features
from beltscape.stereo.multiview.confidence.inputs import ConfidenceInputs
from beltscape.stereo.multiview.confidence.refiner import (
    Prediction,
    RefinementInputs,
    refine_uncertain_pixels,
)
from beltscape.stereo.multiview.frame.surface import Surface
from beltscape.stereo.multiview.selection.candidates import Selection
from beltscape.stereo.multiview.state import MatcherState

Array = NDArray[np.floating]

CONTRADICTION = 0.4
"""Mean dissimilarity from which on the surface is rejected where no view agrees."""


@dataclass(frozen=True, slots=True, eq=False)
class DepthEstimate:
    """The estimate per pixel of the matcher's grid."""

    surface: Surface
    """Its inverse depth is refined at uncertain pixels."""
    sigma: Array
    """(H, W) one standard deviation of s, px."""
    confidence: NDArray[np.float32]
    """(H, W) probability that the pixel is not a false surface."""
    views: NDArray[np.uint8]
    """(H, W) number of auxiliaries that see the pixel."""


def estimate_depth(state: MatcherState) -> DepthEstimate:
    """Return inverse depth, sigma, confidence and views of a matched surface.

    Sigma and confidence are predicted by small networks trained on simulated frames with known truth
    (docs/explanation/matching.md): the confidence is the probability of being right, sigma follows the median error.
    Without a candidate selection the initial features are used. The training frames have white noise; the effect of
    correlated noise is added to sigma afterwards.
    """
    inputs = ConfidenceInputs.from_state(state)
    prediction = _predict(inputs, state.selection)
    confidence = 1 / (1 + np.exp(-prediction.logit))
    contradicted = (inputs.agreeing == 0) & (cv2.blur(inputs.cost, (7, 7)) > CONTRADICTION)
    measurable = np.isfinite(inputs.prepared.core) & (state.textured | state.filled) & ~contradicted
    valid = np.isfinite(prediction.s) & (inputs.visible > 0) & measurable
    return DepthEstimate(
        surface=Surface(prediction.s, inputs.surface.slope_u, inputs.surface.slope_v),
        sigma=inflate_sigma(np.exp(prediction.log_sigma), inputs),
        confidence=np.where(valid, confidence, 0).astype(np.float32),
        views=np.where(valid, inputs.visible, 0).astype(np.uint8),
    )


def _predict(inputs: ConfidenceInputs, selection: Selection | None) -> Prediction:
    """Return the prediction from the initial features, or after candidate selection from the refined ones."""
    s, context = inputs.surface.s, inputs.prepared.context
    if selection is None:
        network, features = load_network("fast_confidence"), compute_initial_features(inputs)
        return Prediction(s, *network.evaluate(features, context.kernels, context.threads))
    network, refinement = load_network("confidence"), RefinementInputs.from_selection(inputs, selection)
    outputs = network.evaluate(refinement.planes, context.kernels, context.threads)
    return refine_uncertain_pixels(Prediction(s, *outputs), refinement)
