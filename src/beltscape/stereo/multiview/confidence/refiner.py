"""Refinement of uncertain pixels: a network shifts their s and estimates confidence and sigma again.

Its features are those of the confidence, the single neighbours, and the photo-consistency a little nearer and
farther. Message passing then combines neighbouring pixels. Planes fitted over windows cut edges and round flanks;
that shows in the neighbours.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.learned.registry import load_network
from beltscape.stereo.multiview.confidence.features import compute_refined_features
from beltscape.stereo.multiview.confidence.inputs import ConfidenceInputs
from beltscape.stereo.multiview.confidence.message_passing import (
    assign_addresses,
    gather_neighbour_addresses,
    load_message_rounds,
    pass_messages,
)
from beltscape.stereo.multiview.frame.context import MatchContext
from beltscape.stereo.multiview.frame.parallel import run_parallel
from beltscape.stereo.multiview.frame.planes import Pixels, split_pixels
from beltscape.stereo.multiview.frame.surface import Surface
from beltscape.stereo.multiview.selection.candidates import Selection
from beltscape.stereo.multiview.selection.neighbourhood import Neighbourhood, sample_planes
from beltscape.stereo.multiview.selection.photoconsistency import (
    PhotoConsistencyModel,
    compute_photo_consistency_features,
)

Array = NDArray[np.floating]

_REJECTED, _ACCEPTED = -2.0, 5.5
"""Logits below which a pixel is rejected and from which on it is accepted without refinement."""
TRIED_PX = (-1.5, -0.8, -0.4, 0.4, 0.8, 1.5)
"""Shifts of s at which the photo-consistency is evaluated, at scale 1."""
MOST_PX = 2.0
"""Largest shift of a pixel, at scale 1."""
_PIXELS = 4096
"""Number of pixels that are processed together."""


class Prediction(NamedTuple):
    """The networks' prediction for some pixels (N,) or for all (H, W)."""

    s: NDArray[np.float32]
    """Inverse depth."""
    logit: NDArray[np.float32]
    """Of the probability that the pixel is right."""
    log_sigma: NDArray[np.float32]
    """Logarithm of the sigma of s, px."""


@dataclass(frozen=True, slots=True, eq=False)
class RefinementInputs:
    """The surface, features and images from which the refinement network's features are computed."""

    planes: Mapping[str, Array]
    """(H, W) features by name, ``initial confidence`` among them."""
    surface: Surface
    consistency: PhotoConsistencyModel
    neighbourhood: Neighbourhood

    @classmethod
    def from_selection(cls, inputs: ConfidenceInputs, selection: Selection) -> RefinementInputs:
        """Return the inputs for a surface after candidate selection."""
        prepared, surface = inputs.prepared, inputs.surface
        consistency = PhotoConsistencyModel(prepared, selection.gain, inputs.buffers)
        planes = compute_refined_features(inputs, selection.initial_confidence, consistency)
        neighbourhood = Neighbourhood.from_surface(surface.s, planes["initial confidence"], prepared)
        return cls(planes, surface, consistency, neighbourhood)

    @property
    def context(self) -> MatchContext:
        """Context of the frame."""
        return self.consistency.prepared.context

    def compute_features(self, pixels: Pixels, logit: Array) -> dict[str, Array]:
        """Return the features (1, N) by name of some pixels, whose confidence so far has the logits (N,)."""
        features = sample_planes(self.planes, pixels, self.context.kernels)
        features |= {"confidence": np.asarray(logit, np.float32)}
        slopes = self.surface.slope_u[pixels], self.surface.slope_v[pixels]
        features |= dict(zip(("slope u", "slope v"), slopes, strict=True))
        features |= self.neighbourhood.compute_image_features(pixels)
        features |= self.neighbourhood.compute_offset_features(pixels, self.surface.s[pixels], slopes)
        features |= self._shifted_consistency(pixels, slopes)
        return {name: values[None] for name, values in features.items()}

    def compute_states(self, pixels: Pixels, logit: Array) -> NDArray[np.float32]:
        """Return the refinement network's (S, N) states of some pixels with logits (N,)."""
        features = self.compute_features(pixels, logit)
        return np.concatenate(load_network("refinement").evaluate(features, self.context.kernels, 1))

    def _shifted_consistency(self, pixels: Pixels, slopes: tuple[Array, Array]) -> dict[str, Array]:
        """Return (N,) by name: the photo-consistency if the pixels were shifted by `TRIED_PX`."""
        scale = np.float32(self.context.scale)
        shifted = self.surface.s[pixels] + scale * np.array(TRIED_PX, np.float32)[:, None]
        slope_u, slope_v = (np.broadcast_to(slope, shifted.shape) for slope in slopes)
        consistency = self.consistency.evaluate(pixels, shifted, (slope_u, slope_v))
        return {
            f"{name} {px:+g}": row
            for name, rows in compute_photo_consistency_features(
                consistency, len(self.consistency.prepared.images)
            )
            if name != "share of visible views"
            for px, row in zip(TRIED_PX, rows, strict=True)
        }


def mask_uncertain(logit: Array) -> NDArray[np.bool_]:
    """Return the mask of pixels that are refined: neither rejected nor accepted."""
    return (logit >= _REJECTED) & (logit < _ACCEPTED)


def mask_accepted(logit: Array) -> NDArray[np.bool_]:
    """Return the mask of pixels that are accepted without refinement."""
    return logit >= _ACCEPTED


def refine_uncertain_pixels(prediction: Prediction, inputs: RefinementInputs) -> Prediction:
    """Return the prediction (H, W) with that of the refinement network at uncertain pixels."""
    refined = Prediction(*(plane.copy() for plane in prediction))
    uncertain = mask_uncertain(prediction.logit) & np.isfinite(prediction.s)
    parts = split_pixels(uncertain, _PIXELS)
    if not parts:
        return refined
    context = inputs.context
    states = _compute_all_states(parts, prediction.logit, inputs)
    addresses = assign_addresses(uncertain, mask_accepted(prediction.logit))
    neighbours = gather_neighbour_addresses(addresses, uncertain, inputs.neighbourhood.spacing)
    logit, log_sigma, shift = pass_messages(
        states, neighbours, load_message_rounds(), context.kernels, context.threads
    )
    px = np.float32(context.scale)
    refined.s[uncertain] += px * np.clip(shift, -MOST_PX, MOST_PX)
    refined.logit[uncertain] = logit
    refined.log_sigma[uncertain] = log_sigma + np.log(px)
    return refined


def _compute_all_states(parts: list[Pixels], logit: Array, inputs: RefinementInputs) -> NDArray[np.float32]:
    """Return the (S, N) states of the pixels of all parts, for logits (H, W)."""
    ends = np.cumsum([len(rows) for rows, _ in parts])
    states = np.empty((len(load_network("refinement").outputs), ends[-1]), np.float32)

    def compute(part: Pixels, end: int) -> None:
        states[:, end - len(part[0]) : end] = inputs.compute_states(part, logit[part])

    run_parallel(
        [partial(compute, part, end) for part, end in zip(parts, ends, strict=True)], inputs.context.threads
    )
    return states
