"""The estimate of a matched surface: inverse depth, sigma, confidence and number of views of every pixel.

A network predicts sigma and confidence of every pixel from its features. The uncertain pixels are refined, because
planes fitted over windows cut edges and round flanks, which shows in the neighbours: the refinement network gives
each a state, whose first numbers are a message to the eight pixels around. In every round of message passing a small
network computes a change of the state from the messages; the last round's network gives shift, confidence and sigma.
So the result of a pixel can depend on features several pixels away (Gilmer et al. 2017, arXiv:1704.01212, with the
messages in their order instead of their sum).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Floats
from beltscape.kernels import Kernels
from beltscape.kernels.planes import FoundPixels, PixelKernels
from beltscape.learned.network import Network
from beltscape.learned.registry import load_network
from beltscape.stereo.multiview.candidates import Selection
from beltscape.stereo.multiview.correlated_noise import inflate_sigma
from beltscape.stereo.multiview.features import ConfidenceInputs, MatcherState, compute_initial_features
from beltscape.stereo.multiview.parallel import Pixels, find_pixels, run_pair, run_parallel, split_pixels
from beltscape.stereo.multiview.refined_features import RefinementInputs
from beltscape.stereo.multiview.surface import Surface

CONTRADICTION = 0.4
"""Mean dissimilarity from which on the surface is rejected where no view agrees."""
_REJECTED, _ACCEPTED = -2.0, 5.5
"""Logits below which a pixel is rejected and from which on it is accepted without refinement."""
MOST_PX = 2.0
"""Largest shift of a pixel, at scale 1."""
_PIXELS = 4096
"""Number of pixels that are processed together."""
REJECTED, ACCEPTED, FIRST_UNCERTAIN = 0, 1, 2
"""Addresses: rejected and accepted pixels have no state of their own; uncertain ones count from the last on."""
OFFSETS = tuple((du, dv) for dv, du in product((-1, 0, 1), repeat=2))
"""Offsets of the pixels whose messages a pixel takes, itself included."""
_ROUNDS = 3
"""Number of rounds; each has a network of its own."""


@dataclass(frozen=True, slots=True, eq=False)
class DepthEstimate:
    """The estimate per pixel of the matcher's grid."""

    surface: Surface
    """Its inverse depth is refined at uncertain pixels."""
    sigma: Floats
    """(H, W) one standard deviation of s, px."""
    confidence: NDArray[np.float32]
    """(H, W) probability that the pixel is not a false surface."""
    views: NDArray[np.uint8]
    """(H, W) number of auxiliaries that see the pixel."""


class Prediction(NamedTuple):
    """The networks' prediction for some pixels (N,) or for all (H, W)."""

    s: NDArray[np.float32]
    """Inverse depth."""
    logit: NDArray[np.float32]
    """Of the probability that the pixel is right."""
    log_sigma: NDArray[np.float32]
    """Logarithm of the sigma of s, px."""


@dataclass(frozen=True, slots=True, eq=False)
class PredictedDepth:
    """What a depth estimate is combined from."""

    prediction: Prediction
    """Of every pixel (H, W)."""
    sigma: Floats
    """(H, W) px, with the excess of correlated noise."""
    inputs: ConfidenceInputs
    mean_cost: Floats
    """(H, W) mean dissimilarity around a pixel."""
    textured: NDArray[np.bool_]
    """(H, W) of the matcher's state, as ``filled``."""
    filled: NDArray[np.bool_]


def estimate_depth(state: MatcherState) -> DepthEstimate:
    """Return inverse depth, sigma, confidence and views of a matched surface.

    Sigma and confidence are predicted by small networks trained on simulated frames with known truth
    (docs/explanation/matching.md): the confidence is the probability of being right, sigma follows the median error.
    Without a candidate selection the initial features are used. The training frames have white noise; the effect of
    correlated noise is added to sigma afterwards.
    """
    return combine_estimate(predict_depth(state))


def predict_depth(state: MatcherState) -> PredictedDepth:
    """Return what `estimate_depth` combines, see there."""
    context = state.prepared.context
    if state.selection is None:
        inputs, features, prediction = context.kernels.replay(_predict_fast, state)
    else:
        selection = state.selection
        inputs, refinement, prediction, uncertain = context.kernels.replay(
            _predict, state, selection, selection.list_doubtful_pixels()
        )
        features = refinement.planes
        prediction = refine_uncertain_pixels(prediction, refinement, uncertain)
    sigma = inflate_sigma(np.exp(prediction.log_sigma), inputs)
    return PredictedDepth(prediction, sigma, inputs, features["mean cost"], state.textured, state.filled)


def combine_estimate(predicted: PredictedDepth) -> DepthEstimate:
    """Return the estimate; only a pixel that is seen, has texture and is not contradicted has a confidence."""
    prediction, inputs = predicted.prediction, predicted.inputs
    confidence = 1 / (1 + np.exp(-prediction.logit))
    contradicted = (inputs.agreeing == 0) & (predicted.mean_cost > CONTRADICTION)
    measurable = np.isfinite(inputs.prepared.core) & (predicted.textured | predicted.filled) & ~contradicted
    valid = np.isfinite(prediction.s) & (inputs.visible > 0) & measurable
    return DepthEstimate(
        surface=Surface(prediction.s, inputs.surface.slope_u, inputs.surface.slope_v),
        sigma=predicted.sigma,
        confidence=np.where(valid, confidence, np.float32(0)),
        views=np.where(valid, inputs.visible, np.uint8(0)),
    )


def _compute_inputs(state: MatcherState) -> tuple[ConfidenceInputs, dict[str, Floats]]:
    """Return what the features are computed from, and those before the candidate selection."""
    inputs = ConfidenceInputs.from_state(state)
    return inputs, compute_initial_features(inputs)


def _predict_fast(state: MatcherState) -> tuple[ConfidenceInputs, dict[str, Floats], Prediction]:
    """Return inputs, features and prediction without a candidate selection."""
    context = state.prepared.context
    inputs, features = _compute_inputs(state)
    outputs = load_network("fast_confidence").evaluate(features, context.kernels, context.threads)
    return inputs, features, Prediction(inputs.surface.s, *outputs)


def _predict(
    state: MatcherState, selection: Selection, doubtful: Pixels | None
) -> tuple[ConfidenceInputs, RefinementInputs, Prediction, FoundPixels | NDArray[np.bool_]]:
    """Return the inputs, those of the refinement, the prediction (H, W) before it, and the pixels to be refined."""
    context = state.prepared.context
    inputs, features = _compute_inputs(state)
    refinement = RefinementInputs.from_selection(inputs, features, selection, doubtful)
    outputs = load_network("confidence").evaluate(refinement.planes, context.kernels, context.threads)
    prediction = Prediction(inputs.surface.s, *outputs)
    return inputs, refinement, prediction, find_uncertain_pixels(prediction)


def find_uncertain_pixels(prediction: Prediction) -> FoundPixels | NDArray[np.bool_]:
    """Return the pixels that are refined, of a prediction (H, W)."""
    return find_pixels(mask_uncertain(prediction.logit) & np.isfinite(prediction.s))


def refine_uncertain_pixels(
    prediction: Prediction,
    inputs: RefinementInputs,
    uncertain: FoundPixels | NDArray[np.bool_] | None = None,
) -> Prediction:
    """Return the prediction (H, W) with that of the refinement network at uncertain pixels, found already or not."""
    if uncertain is None:
        uncertain = find_uncertain_pixels(prediction)
    if isinstance(uncertain, FoundPixels):
        pixels = uncertain.cut()
        if not len(pixels[0]):
            return prediction
        return inputs.context.kernels.replay(_refine_at, pixels, prediction, inputs)
    refined, context = Prediction(*(plane.copy() for plane in prediction)), inputs.context
    if not uncertain.any():
        return refined
    addresses = assign_addresses(uncertain, mask_accepted(prediction.logit))
    states, neighbours = run_pair(
        lambda: _compute_states(uncertain, addresses, prediction.logit, inputs),
        lambda: gather_neighbour_addresses(addresses, uncertain, inputs.neighbourhood.spacing),
        context.threads,
    )
    logit, log_sigma, shift = pass_messages(
        states, neighbours, load_message_rounds(), context.kernels, context.threads
    )
    px = np.float32(context.scale)
    s, at = refined.s.ravel(), np.flatnonzero(uncertain)
    s[at] += px * np.clip(shift, -MOST_PX, MOST_PX)
    refined.logit.ravel()[at] = logit
    refined.log_sigma.ravel()[at] = log_sigma + np.log(px)
    return refined


def _refine_at(pixels: Pixels, prediction: Prediction, inputs: RefinementInputs) -> Prediction:
    """Return what `refine_uncertain_pixels` does, of planes on a GPU; ``pixels`` are the uncertain ones."""
    context, px = inputs.context, np.float32(inputs.context.scale)
    kernels = PixelKernels(context.kernels.backend)
    accepted = mask_accepted(prediction.logit)
    addresses = kernels.assign_addresses(pixels, accepted, FIRST_UNCERTAIN)
    offsets = inputs.neighbourhood.spacing * np.array(OFFSETS)
    bits = context.kernels.gather([addresses.view(np.float32)], pixels[1], pixels[0], offsets)
    neighbours = bits.reshape(len(OFFSETS), -1).view(np.int32)
    states = _evaluate_states(pixels, prediction.logit, inputs)
    logit, log_sigma, shift = pass_messages(
        states, neighbours, load_message_rounds(), context.kernels, context.threads
    )
    changed = (
        prediction.s[pixels] + px * np.clip(shift, -MOST_PX, MOST_PX),
        logit,
        log_sigma + np.log(px),
    )
    return Prediction(
        *(kernels.put_pixels(plane, pixels, new) for plane, new in zip(prediction, changed, strict=True))
    )


def mask_uncertain(logit: Floats) -> NDArray[np.bool_]:
    """Return the mask of pixels that are refined: neither rejected nor accepted."""
    return (logit >= _REJECTED) & (logit < _ACCEPTED)


def mask_accepted(logit: Floats) -> NDArray[np.bool_]:
    """Return the mask of pixels that are accepted without refinement."""
    return logit >= _ACCEPTED


def _compute_states(
    uncertain: NDArray[np.bool_], addresses: NDArray[np.int32], logit: Floats, inputs: RefinementInputs
) -> Sequence[NDArray[np.float32]]:
    """Return the refinement network's S states (N,) of uncertain pixels in the order of their addresses (H, W)."""
    network, context = load_network("refinement"), inputs.context
    parts = split_pixels(uncertain, context.kernels.choose_pixels(_PIXELS))
    if len(parts) == 1:
        return _evaluate_states(parts[0], logit, inputs)
    states = np.empty((len(network.outputs), np.count_nonzero(uncertain)), np.float32)

    def compute(part: Pixels) -> None:
        features = inputs.compute_features(part, logit[part])
        first = addresses[part][0] - FIRST_UNCERTAIN
        out = [state[None, first : first + len(part[0])] for state in states]
        network.evaluate(features, context.kernels, 1, out)

    run_parallel([partial(compute, part) for part in parts], context.threads)
    return list(states)


def _evaluate_states(
    pixels: Pixels, logit: Floats, inputs: RefinementInputs
) -> Sequence[NDArray[np.float32]]:
    """Return the refinement network's S states (N,) of some pixels, with the logit (H, W)."""
    features, context = inputs.compute_features(pixels, logit[pixels]), inputs.context
    states = load_network("refinement").evaluate(features, context.kernels, context.threads)
    return [state.reshape(-1) for state in states]


def assign_addresses(uncertain: NDArray[np.bool_], accepted: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return the (H, W) addresses: uncertain pixels are numbered row by row, others are accepted or rejected."""
    address = np.where(accepted, ACCEPTED, REJECTED).astype(np.int32)
    last = FIRST_UNCERTAIN + np.count_nonzero(uncertain)
    address.ravel()[np.flatnonzero(uncertain)] = np.arange(FIRST_UNCERTAIN, last, dtype=np.int32)
    return address


def gather_neighbour_addresses(
    address: NDArray[np.int32], uncertain: NDArray[np.bool_], spacing: int
) -> NDArray[np.int32]:
    """Return the (9, N) addresses of the uncertain pixels' neighbours, ``spacing`` px apart, limited to the image."""
    padded = np.pad(address, spacing, mode="edge")
    rows, columns = np.unravel_index(np.flatnonzero(uncertain), uncertain.shape)
    places = (rows + spacing) * padded.shape[1] + columns + spacing
    neighbours = np.empty((len(OFFSETS), len(places)), np.int32)
    for (du, dv), row in zip(OFFSETS, neighbours, strict=True):
        np.take(padded, places + spacing * (dv * padded.shape[1] + du), out=row, mode="clip")
    return neighbours


def load_message_rounds() -> tuple[Network, ...]:
    """Return the shipped networks of the rounds."""
    return tuple(load_network(f"message_round_{i + 1}") for i in range(_ROUNDS))


def pass_messages(
    states: Sequence[NDArray[np.float32]] | NDArray[np.float32],
    neighbours: NDArray[np.int32],
    rounds: Sequence[Network],
    kernels: Kernels,
    threads: int,
) -> NDArray[np.float32]:
    """Return the (M, N) outputs of the last round, for S states (N,) and the addresses ``neighbours`` (9, N)."""
    outputs = kernels.exchange_messages(
        list(states), neighbours, [network.layers for network in rounds], threads=threads
    )
    return outputs.astype(np.float32, copy=False)
