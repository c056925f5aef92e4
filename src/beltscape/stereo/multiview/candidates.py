"""Selection among candidate surfaces: uncertain pixels compare theirs with those of reliable pixels nearby.

Propagation compares candidates by windows of 3 × 3 normalised levels. Here the features of a candidate are also the
levels themselves, the other candidates and the pixel's neighbourhood. A small network, trained on simulated frames
with known truth, estimates the probability of each (docs/explanation/matching.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Floats
from beltscape.kernels.planes import FoundPixels, PixelKernels, dilate, find_pixel_kernels
from beltscape.kernels.selection import Candidates
from beltscape.learned.registry import load_network
from beltscape.stereo.multiview.frame import PreparedFrame
from beltscape.stereo.multiview.parallel import Pixels, find_pixels, run_parallel, split_pixels
from beltscape.stereo.multiview.photoconsistency import (
    PhotoConsistencyModel,
    PhotometricGain,
    compute_photo_consistency_features,
    estimate_gain,
    find_doubtful_pixels,
)
from beltscape.stereo.multiview.surface import Surface

REACH_PX = 8
"""Distance from which candidates come, at scale 1."""
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
    doubtful: FoundPixels | None = None
    """On a GPU the `find_doubtful_pixels` of the confidence, so that their number is known when it is refined."""

    def list_doubtful_pixels(self) -> Pixels | None:
        """Return the doubtful pixels of a GPU, for whose number the processor waits; else None."""
        return self.doubtful.cut() if self.doubtful else None


def begin_selection(
    surface: Surface, planes: Mapping[str, Floats], prepared: PreparedFrame
) -> tuple[CandidateSelector, FoundPixels | NDArray[np.bool_]]:
    """Return the selector, and the uncertain pixels; ``planes`` (H, W) are the `PIXEL_FEATURES` by name."""
    selector = CandidateSelector.from_surface(surface, planes, prepared)
    return selector, find_pixels(selector.mask_uncertain())


def finish_selection(selector: CandidateSelector, uncertain: FoundPixels | NDArray[np.bool_]) -> Selection:
    """Return the surface on which uncertain pixels near reliable ones have the most probable candidate's surface.

    The selector and the pixels are those of `begin_selection`.
    """
    surface, context = selector.surface, selector.consistency.prepared.context
    parts = selector.split_pixels(uncertain)
    if isinstance(uncertain, FoundPixels):
        return _select_on_device(selector, parts)
    s, slope_u, slope_v = (x.copy() for x in (surface.s, surface.slope_u, surface.slope_v))
    confidence = np.array(selector.planes["initial confidence"], np.float32)

    def select_at(pixels: Pixels) -> None:
        candidates, features = selector.find_candidates(pixels)
        selected, logit = selector.select(candidates, features)
        changed = np.flatnonzero(selected)  # 0 is the pixel's own surface
        at = pixels[0][changed], pixels[1][changed]
        offers = (s, candidates.s), (slope_u, candidates.slope_u), (slope_v, candidates.slope_v)
        for plane, offered in offers:
            plane[at] = offered[selected[changed], changed]
        confidence[pixels] = np.where(np.isfinite(logit), logit, confidence[pixels])

    jobs = [partial(select_at, pixels) for pixels in parts]
    run_parallel(jobs, context.threads)
    return Selection(Surface(s, slope_u, slope_v), confidence, selector.consistency.gain)


def _select_on_device(selector: CandidateSelector, parts: Sequence[Pixels]) -> Selection:
    """Return what `finish_selection` does, of planes on a GPU."""
    surface, replay = selector.surface, selector.consistency.prepared.context.kernels.replay
    selected = [surface.s, surface.slope_u, surface.slope_v, selector.planes["initial confidence"]]
    doubtful: FoundPixels | None = None
    for pixels in parts:
        selected, doubtful = replay(_select_at, selector, pixels, selected)
    *planes, confidence = selected
    doubtful = doubtful or cast("FoundPixels", replay(find_doubtful_pixels, confidence))
    return Selection(Surface(*planes), confidence, selector.consistency.gain, doubtful)


def _select_at(
    selector: CandidateSelector, pixels: Pixels, selected: list[Floats]
) -> tuple[list[Floats], FoundPixels]:
    """Return s, its slopes and the initial confidence (H, W) with those of selected candidates at some pixels.

    Besides, the pixels that are doubtful then.
    """
    kernels = PixelKernels(selector.consistency.prepared.context.kernels.backend)
    candidates, features = selector.find_candidates(pixels)
    logits = selector.compute_logits(candidates, features)
    numbers = np.zeros_like(logits) + np.arange(len(logits), dtype=np.float32)[:, None]
    *offered, logit, number = kernels.pick_best(logits, [*candidates[:3], logits, numbers])
    own = [plane[pixels] for plane in selected]
    found: list[Floats] = [np.where(number > 0, new, old) for new, old in zip(offered, own, strict=False)]
    found.append(np.where(np.isfinite(logit), logit, own[-1]))
    planes = [
        kernels.put_pixels(plane, pixels, values) for plane, values in zip(selected, found, strict=True)
    ]
    return planes, cast("FoundPixels", find_doubtful_pixels(planes[-1]))


@dataclass(frozen=True, slots=True, eq=False)
class CandidateSelector:
    """The surface, features and images from which candidates are found and ranked."""

    surface: Surface
    planes: Mapping[str, Floats]
    reliable: NDArray[np.uint8]
    """(H, W) 1 for pixels that offer their surface."""
    consistency: PhotoConsistencyModel

    @classmethod
    def from_surface(
        cls, surface: Surface, planes: Mapping[str, Floats], prepared: PreparedFrame
    ) -> CandidateSelector:
        """Return the selector for a surface with its `PIXEL_FEATURES` (H, W) by name."""
        confidence = planes["initial confidence"]
        buffers = _buffer_occluders(surface.s, confidence, prepared)
        gain = estimate_gain(surface.s, planes["cost"], prepared, buffers)
        reliable = (confidence >= RELIABLE).astype(np.uint8)
        return cls(surface, planes, reliable, PhotoConsistencyModel(prepared, gain, buffers))

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
        return self.split_pixels(find_pixels(self.mask_uncertain()))

    def split_pixels(self, found: FoundPixels | NDArray[np.bool_]) -> list[Pixels]:
        """Return the pixels in parts that are processed together."""
        return split_pixels(found, self.consistency.prepared.context.kernels.choose_pixels(_PIXELS))

    def mask_uncertain(self) -> NDArray[np.bool_]:
        """Return the mask (H, W) of uncertain pixels within reach of reliable ones."""
        side = 2 * self.reach + 1
        uncertain = self.planes["initial confidence"] < UNCERTAIN
        uncertain = uncertain & np.isfinite(self.consistency.prepared.core)
        return uncertain & (dilate(self.reliable, (side, side)) > 0)

    def find_candidates(self, pixels: Pixels) -> tuple[Candidates, dict[str, Floats]]:
        """Return the candidates of some pixels, and the features (1, M) by name of the M with a surface, in rows."""
        surface, prepared = self.surface, self.consistency.prepared
        candidates = prepared.context.kernels.candidate_surfaces(
            surface.s, surface.slope_u, surface.slope_v, self.reliable, pixels[1], pixels[0], reach=self.reach,
            separation=SAME_PX * self.scale, threads=1,
        )  # fmt: skip
        listed = _list_candidates(candidates)
        if not listed.candidates.s.size:
            return candidates, {}
        features = {name: listed.spread(self.planes[name][pixels]) for name in PIXEL_FEATURES}
        features |= _compute_candidate_features(candidates, listed, self.scale)
        consistency = self.consistency.evaluate(
            (pixels[0][listed.pixel], pixels[1][listed.pixel]),
            listed.candidates.s,
            (listed.candidates.slope_u, listed.candidates.slope_v),
        )
        return candidates, features | dict(
            compute_photo_consistency_features(consistency, len(prepared.images))
        )

    def select(
        self, candidates: Candidates, features: Mapping[str, Floats]
    ) -> tuple[NDArray[np.int_], Floats]:
        """Return (N,) each: the selected candidate, and the logit of its probability; -inf where there is none."""
        logits = self.compute_logits(candidates, features)
        selected = logits.argmax(axis=0)
        return selected, logits[selected, np.arange(len(selected))]

    def compute_logits(self, candidates: Candidates, features: Mapping[str, Floats]) -> Floats:
        """Return (9, N) the logit of each candidate's probability; -inf where there is none."""
        logits = np.full(candidates.s.shape, -np.inf, np.float32)
        if not features:
            return logits
        kernels = self.consistency.prepared.context.kernels
        (logit,) = load_network("candidates").evaluate(features, kernels, 1)
        if find_pixel_kernels(logit):
            return np.where(np.isfinite(candidates.s), logit, np.float32(-np.inf))
        logits[np.isfinite(candidates.s)] = logit[0]
        return logits


def _buffer_occluders(s: Floats, confidence: Floats, prepared: PreparedFrame) -> Sequence[Floats]:
    """Return n of (h, w): the auxiliaries' inverse-depth buffers of the pixels that occlude others."""
    context = prepared.context
    occluders = np.where(confidence > OCCLUDING, s, np.nan).astype(np.float32)
    return context.kernels.inverse_depth_buffers(
        occluders, prepared.views, prepared.sizes, threads=context.threads
    )


class _ListedCandidates(NamedTuple):
    """The M candidates of N pixels that have a surface, row by row; on a GPU all (9, N), with or without one."""

    candidates: Candidates
    """(1, M) each."""
    pixel: NDArray[np.int_] | slice
    """(M,) among the N; on a GPU all of them."""
    own: NDArray[Any]
    """(1, M) whether it is the pixel's own surface."""

    def spread(self, values: Floats) -> Floats:
        """Return (1, M) the values (N,) of the candidates' pixels."""
        return np.broadcast_to(values[self.pixel][None], self.candidates.s.shape)


def _list_candidates(candidates: Candidates) -> _ListedCandidates:
    """Return the candidates (9, N) that have a surface."""
    if find_pixel_kernels(candidates.s):
        own = np.zeros_like(candidates.s) + np.eye(len(candidates.s), 1, dtype=np.float32)
        return _ListedCandidates(candidates, slice(None), own)
    pixels, places = candidates.s.shape[1], np.flatnonzero(np.isfinite(candidates.s))
    listed = Candidates(*(plane.ravel()[places][None] for plane in candidates))
    return _ListedCandidates(listed, places % pixels, (places < pixels)[None])


def _compute_candidate_features(
    candidates: Candidates, listed: _ListedCandidates, scale: float
) -> Iterator[tuple[str, Floats]]:
    """Yield features (1, M) by name, of the listed candidates' positions among all (9, N) of their pixels."""
    px, (s, slope_u, slope_v, distance, support) = np.float32(1 / scale), listed.candidates
    yield "distance", distance * px
    yield "support", support
    yield "slope", np.hypot(slope_u, slope_v)
    yield "offset from own surface", _compress(px * (s - candidates.s[0][listed.pixel]))
    yield "offset from farthest", _compress(px * (s - reduce(np.fmin, candidates.s)[listed.pixel]))
    yield "offset from nearest", _compress(px * (reduce(np.fmax, candidates.s)[listed.pixel] - s))
    yield "own surface", listed.own.astype(np.float32, copy=False)


def _compress(px: Floats) -> Floats:
    """Return distances with large ones compressed to their logarithm."""
    return np.copysign(np.log1p(np.abs(px)), px)
