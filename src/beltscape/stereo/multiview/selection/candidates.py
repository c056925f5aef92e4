"""Selection among candidate surfaces: uncertain pixels compare theirs with those of reliable pixels nearby.

Propagation compares candidates by windows of 3 × 3 normalised levels. Here the features of a candidate are also the
levels themselves, the other candidates and the pixel's neighbourhood. Small networks, trained on simulated frames
with known truth, rank the candidates (docs/explanation/matching.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.selection.candidates import Candidates
from beltscape.learned.registry import load_network
from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.frame.parallel import run_parallel
from beltscape.stereo.multiview.frame.planes import Pixels, split_pixels
from beltscape.stereo.multiview.frame.surface import Surface
from beltscape.stereo.multiview.selection.gain import PhotometricGain, estimate_gain
from beltscape.stereo.multiview.selection.neighbourhood import Neighbourhood, sample_planes
from beltscape.stereo.multiview.selection.photoconsistency import (
    PhotoConsistencyModel,
    compute_photo_consistency_features,
)

Array = NDArray[np.floating]

REACH_PX = 8
"""Distance from which candidates come, at scale 1."""
NEIGHBOURHOOD_PX = 2
"""Neighbours to each side that are features of the pairwise ranking."""
SAME_PX = 1.0
"""Difference in s up to which candidates are the same surface, at scale 1."""
RELIABLE, OCCLUDING, UNCERTAIN = 1.0, 0.0, 1.5
"""Initial confidence (logit) from which on a pixel offers its surface and occludes others, and below which it is
compared with candidates."""
PIXEL_FEATURES = (
    "initial confidence", "initial confidence within 3", "initial confidence within 7",
    "initial confidence within 15", "log sigma", "cost", "margin", "relative brightness within 5",
    "relative brightness within 11", "relative contrast within 5", "log grid scale",
)  # fmt: skip
"""Features of the pixel itself that are common to all its candidates."""
_PIXELS = 16384
"""Number of pixels that are processed together."""


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """The surface of the selected candidates, and its initial confidence."""

    surface: Surface
    initial_confidence: NDArray[np.float32]
    """(H, W) logit of the probability of being right; the selected candidate's where there were candidates."""
    gain: PhotometricGain
    """Gain with which the levels were compared."""


def select_candidates(surface: Surface, planes: Mapping[str, Array], prepared: PreparedFrame) -> Selection:
    """Return the surface on which uncertain pixels near reliable ones have the most probable candidate's surface.

    ``planes`` (H, W) are the `PIXEL_FEATURES` by name.
    """
    selector = CandidateSelector.from_surface(surface, planes, prepared)
    s, slope_u, slope_v = (x.copy() for x in (surface.s, surface.slope_u, surface.slope_v))
    confidence = np.array(planes["initial confidence"], np.float32)

    def select_at(pixels: Pixels) -> None:
        candidates, features = selector.find_candidates(pixels)
        selected, logit = selector.select(pixels, candidates, features)
        offers = (s, candidates.s), (slope_u, candidates.slope_u), (slope_v, candidates.slope_v)
        for plane, offered in offers:
            plane[pixels] = np.where(selected > 0, offered[selected, np.arange(len(selected))], plane[pixels])
        confidence[pixels] = np.where(np.isfinite(logit), logit, confidence[pixels])

    jobs = [partial(select_at, pixels) for pixels in selector.find_uncertain_pixels()]
    run_parallel(jobs, prepared.context.threads)
    return Selection(Surface(s, slope_u, slope_v), confidence, selector.consistency.gain)


@dataclass(frozen=True, slots=True, eq=False)
class CandidateSelector:
    """The surface, features and images from which candidates are found and ranked."""

    surface: Surface
    planes: Mapping[str, Array]
    reliable: NDArray[np.uint8]
    """(H, W) 1 for pixels that offer their surface."""
    consistency: PhotoConsistencyModel
    neighbourhood: Neighbourhood

    @classmethod
    def from_surface(
        cls, surface: Surface, planes: Mapping[str, Array], prepared: PreparedFrame
    ) -> CandidateSelector:
        """Return the selector for a surface with its `PIXEL_FEATURES` (H, W) by name."""
        context, confidence = prepared.context, planes["initial confidence"]
        occluders = np.where(confidence > OCCLUDING, surface.s, np.nan).astype(np.float32)
        buffers = context.kernels.inverse_depth_buffers(
            occluders, prepared.views, prepared.sizes, threads=context.threads
        )
        gain = estimate_gain(surface.s, planes["cost"], prepared, buffers)
        reliable = (confidence >= RELIABLE).astype(np.uint8)
        neighbourhood = Neighbourhood.from_surface(surface.s, confidence, prepared, NEIGHBOURHOOD_PX)
        return cls(surface, planes, reliable, PhotoConsistencyModel(prepared, gain, buffers), neighbourhood)

    @property
    def scale(self) -> float:
        """Factor of distances in px."""
        return self.consistency.prepared.context.scale

    @property
    def reach(self) -> int:
        """Distance from which candidates come, px."""
        return max(1, round(REACH_PX * self.scale))

    def find_uncertain_pixels(self) -> list[Pixels]:
        """Return the uncertain pixels within reach of reliable ones, in parts."""
        window = np.ones((2 * self.reach + 1, 2 * self.reach + 1), np.uint8)
        uncertain = self.planes["initial confidence"] < UNCERTAIN
        uncertain = uncertain & np.isfinite(self.consistency.prepared.core)
        return split_pixels(uncertain & (cv2.dilate(self.reliable, window) > 0), _PIXELS)

    def find_candidates(self, pixels: Pixels) -> tuple[Candidates, dict[str, Array]]:
        """Return the candidates of some pixels, and the features (9, N) of each by name."""
        surface, prepared = self.surface, self.consistency.prepared
        candidates = prepared.context.kernels.candidate_surfaces(
            surface.s, surface.slope_u, surface.slope_v, self.reliable, pixels[1], pixels[0], reach=self.reach,
            separation=SAME_PX * self.scale, threads=1,
        )  # fmt: skip
        slopes = candidates.slope_u, candidates.slope_v
        consistency = self.consistency.evaluate(pixels, candidates.s, slopes)
        features = {
            name: np.broadcast_to(self.planes[name][pixels], candidates.s.shape) for name in PIXEL_FEATURES
        }
        features |= compute_photo_consistency_features(consistency, len(prepared.images))
        return candidates, features | dict(_compute_candidate_features(candidates, self.scale))

    def select(
        self, pixels: Pixels, candidates: Candidates, features: Mapping[str, Array]
    ) -> tuple[NDArray[np.int_], Array]:
        """Return (N,) each: the selected candidate, and the logit of its probability; -inf where there is none.

        A second network compares the top two of every pixel.
        """
        first, second, score = self.rank_top_two(candidates, features)
        pixel = np.arange(len(first))
        selected, logit = first.copy(), score[first, pixel]
        paired = np.flatnonzero(second >= 0)
        if len(paired):
            top_two = first[paired], second[paired]
            pairs = self.compute_pairwise_features(
                pixels, candidates, {**features, "score": score}, paired, top_two
            )
            kernels = self.consistency.prepared.context.kernels
            logits = np.concatenate(load_network("pairwise_ranking").evaluate(pairs, kernels, 1))
            selected[paired] = np.where(logits[1] > logits[0], top_two[1], top_two[0])
            logit[paired] = logits.max(axis=0)
        return selected, logit

    def rank_top_two(
        self, candidates: Candidates, features: Mapping[str, Array]
    ) -> tuple[NDArray[np.int_], NDArray[np.int_], Array]:
        """Return (N,) the best candidate and the best with another s (-1: none), and (9, N) logits of all."""
        kernels = self.consistency.prepared.context.kernels
        (score,) = load_network("candidates").evaluate(features, kernels, 1)
        score = np.where(np.isfinite(candidates.s), score, -np.inf)
        first = score.argmax(axis=0)
        first_s = np.take_along_axis(candidates.s, first[None], axis=0)
        with np.errstate(invalid="ignore"):
            others = np.where(np.abs(candidates.s - first_s) > SAME_PX * self.scale, score, -np.inf)
        return first, np.where(np.isfinite(others.max(axis=0)), others.argmax(axis=0), -1), score

    def compute_pairwise_features(
        self,
        pixels: Pixels,
        candidates: Candidates,
        features: Mapping[str, Array],
        paired: NDArray[np.int_],
        top_two: tuple[NDArray[np.int_], NDArray[np.int_]],
    ) -> dict[str, Array]:
        """Return the features (1, M) of the top two candidates (M,) at the pixels ``paired`` (M,) of N, by name."""
        kernels = self.consistency.prepared.context.kernels
        at = pixels[0][paired], pixels[1][paired]
        pixel_planes = {name: self.planes[name] for name in PIXEL_FEATURES}
        own = {name: values for name, values in features.items() if name not in PIXEL_FEATURES}
        pairs = sample_planes(pixel_planes, at, kernels) | self.neighbourhood.compute_image_features(at)
        for rank, index in zip(("first", "second"), top_two, strict=True):
            slopes = candidates.slope_u[index, paired], candidates.slope_v[index, paired]
            offsets = self.neighbourhood.compute_offset_features(at, candidates.s[index, paired], slopes)
            ranked = sample_planes(own, (index, paired), kernels) | offsets
            pairs |= {f"{rank} {name}": values for name, values in ranked.items()}
        return {name: values[None] for name, values in pairs.items()}


def _compute_candidate_features(candidates: Candidates, scale: float) -> Iterator[tuple[str, Array]]:
    """Yield features (9, N) of each candidate's position among the others, by name."""
    px = np.float32(1 / scale)
    yield "distance", candidates.distance * px
    yield "support", candidates.support
    yield "slope", np.hypot(candidates.slope_u, candidates.slope_v)
    yield "offset from own surface", _compress(px * (candidates.s - candidates.s[:1]))
    yield "offset from farthest", _compress(px * (candidates.s - np.fmin.reduce(candidates.s)))
    yield "offset from nearest", _compress(px * (np.fmax.reduce(candidates.s) - candidates.s))
    own = np.zeros_like(candidates.s)
    own[0] = 1
    yield "own surface", own


def _compress(px: Array) -> Array:
    """Return distances with large ones compressed to their logarithm."""
    return np.sign(px) * np.log1p(np.abs(px))
