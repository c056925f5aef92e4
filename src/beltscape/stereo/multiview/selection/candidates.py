"""A closer look at doubtful pixels: their surface competes with those that trusted pixels nearby hand on.

Propagation judges candidates by windows of 3 x 3 normalised levels. Here a rival is also judged by the levels
themselves, by who else says the same, and by what the pixel's surroundings are like; a small network, fitted to
simulated frames with known truth, weighs all of it (docs/matching.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels
from beltscape.kernels.candidates import Candidates, PhotoConsistency
from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.frame.parallel import run_parallel
from beltscape.stereo.multiview.frame.pixels import Pixels, split_pixels
from beltscape.stereo.multiview.frame.surface import Surface
from beltscape.stereo.multiview.networks import load_network
from beltscape.stereo.multiview.selection.gain import PhotometricGain, estimate_gain
from beltscape.stereo.multiview.selection.neighbourhood import Neighbourhood, sample_planes
from beltscape.stereo.multiview.selection.photoconsistency import (
    PhotoConsistencyModel,
    photo_consistency_features,
)

Array = NDArray[np.floating]

REACH_PX = 8
"""From where rivals come, at scale 1."""
AROUND_PX = 2
"""So far about a pixel finalists are looked at, at scale 1."""
SAME_PX = 1.0
"""Candidates so close in s say the same, at scale 1."""
RELIABLE, OCCLUDING, UNCERTAIN = 1.0, 0.0, 1.5
"""Logits: from which on a pixel hands its surface on and hides others, and up to which it is looked at again."""
PIXEL_FEATURES = (
    "impression", "impression within 3", "impression within 7", "impression within 15", "log sigma", "cost",
    "margin", "light within 5", "light within 11", "contrast within 5", "size",
)  # fmt: skip
"""What of a pixel's evidence rivals are judged by, besides their own."""
_PIXELS = 16384
"""So many are looked at at a time."""


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """The surface of the winners, and what is thought of it."""

    surface: Surface
    impression: NDArray[np.float32]
    """(H, W) logit of a pixel's being right: the winner's where there was a contest."""
    brightness: PhotometricGain
    """What the levels were compared by."""


def select_candidates(
    surface: Surface,
    planes: Mapping[str, Array],
    prepared: PreparedFrame,
    scale: float,
    kernels: Kernels,
    threads: int,
) -> Selection:
    """Doubtful pixels within reach of trusted ones take the likeliest of their rivals' surfaces.

    ``planes`` (H, W) is the evidence of `PIXEL_FEATURES` by name.
    """
    arena = CandidateSelector.of(surface, planes, prepared, scale, kernels, threads)
    s, slope_u, slope_v = (x.copy() for x in (surface.s, surface.slope_u, surface.slope_v))
    impression = np.array(planes["impression"], np.float32)

    def settle(at: Pixels) -> None:
        rivals, evidence = arena.look(at)
        winner, logit = arena.winners(at, rivals, evidence)
        for field, offered in ((s, rivals.s), (slope_u, rivals.slope_u), (slope_v, rivals.slope_v)):
            field[at] = np.where(winner > 0, offered[winner, np.arange(len(winner))], field[at])
        impression[at] = np.where(np.isfinite(logit), logit, impression[at])

    run_parallel([partial(settle, at) for at in arena.doubtful()], threads)
    return Selection(Surface(s, slope_u, slope_v), impression, arena.likeness.brightness)


@dataclass(frozen=True, slots=True, eq=False)
class CandidateSelector:
    """All that rivals are found and judged by."""

    surface: Surface
    planes: Mapping[str, Array]
    trusted: NDArray[np.uint8]
    """(H, W) who hands on a surface."""
    likeness: PhotoConsistencyModel
    surroundings: Neighbourhood
    scale: float

    @classmethod
    def of(
        cls,
        surface: Surface,
        planes: Mapping[str, Array],
        prepared: PreparedFrame,
        scale: float,
        kernels: Kernels,
        threads: int,
    ) -> CandidateSelector:
        """Of a surface and the evidence (H, W) of `PIXEL_FEATURES` by name."""
        hiding = np.where(planes["impression"] > OCCLUDING, surface.s, np.nan).astype(np.float32)
        buffers = kernels.inverse_depth_buffers(hiding, prepared.views, prepared.sizes, threads=threads)
        light = estimate_gain(surface.s, planes["cost"], prepared, buffers, scale, kernels, threads)
        trusted = (planes["impression"] >= RELIABLE).astype(np.uint8)
        around = Neighbourhood.of(surface.s, planes["impression"], prepared.core, AROUND_PX, scale, kernels)
        likeness = PhotoConsistencyModel(prepared, light, buffers, kernels)
        return cls(surface, planes, trusted, likeness, around, scale)

    @property
    def reach(self) -> int:
        """From how far away rivals come, px."""
        return max(1, round(REACH_PX * self.scale))

    def doubtful(self) -> list[Pixels]:
        """The doubtful pixels within reach of trusted ones, some at a time."""
        window = np.ones((2 * self.reach + 1, 2 * self.reach + 1), np.uint8)
        doubt = (self.planes["impression"] < UNCERTAIN) & np.isfinite(self.likeness.prepared.core)
        return split_pixels(doubt & (cv2.dilate(self.trusted, window) > 0), _PIXELS)

    def look(self, at: Pixels) -> tuple[Candidates, dict[str, Array]]:
        """The rivals of some pixels, and the evidence (9, N) for each by name."""
        surface = self.surface
        rivals = self.likeness.kernels.candidate_surfaces(
            surface.s, surface.slope_u, surface.slope_v, self.trusted, at[1], at[0], reach=self.reach,
            separation=SAME_PX * self.scale, threads=1,
        )  # fmt: skip
        like = self.likeness.of(at, *rivals[:3])
        about = {name: np.broadcast_to(self.planes[name][at], rivals.s.shape) for name in PIXEL_FEATURES}
        return rivals, about | dict(_speaking(rivals, like, self.scale, len(self.likeness.prepared.images)))

    def winners(
        self, at: Pixels, rivals: Candidates, evidence: Mapping[str, Array]
    ) -> tuple[NDArray[np.int_], Array]:
        """(N,) each: which rival wins, and the logit of its being right; -inf where there is none.

        The likeliest and the likeliest of those that say something else meet in a duel.
        """
        first, second, score = self.finalists(rivals, evidence)
        pixel = np.arange(len(first))
        winner, logit = first.copy(), score[first, pixel]
        met = np.flatnonzero(second >= 0)
        if len(met):
            both = self.duel(at, rivals, {**evidence, "score": score}, met, (first[met], second[met]))
            logits = np.concatenate(load_network("duel").answers(both, self.likeness.kernels, 1))
            winner[met] = np.where(logits[1] > logits[0], second[met], first[met])
            logit[met] = logits.max(axis=0)
        return winner, logit

    def finalists(
        self, rivals: Candidates, evidence: Mapping[str, Array]
    ) -> tuple[NDArray[np.int_], NDArray[np.int_], Array]:
        """(N,) the likeliest and the likeliest that says something else (-1: none), and (9, N) logits."""
        (score,) = load_network("rivals").answers(evidence, self.likeness.kernels, 1)
        score = np.where(np.isfinite(rivals.s), score, -np.inf)
        first = score.argmax(axis=0)
        said = np.take_along_axis(rivals.s, first[None], axis=0)
        with np.errstate(invalid="ignore"):
            others = np.where(np.abs(rivals.s - said) > SAME_PX * self.scale, score, -np.inf)
        return first, np.where(np.isfinite(others.max(axis=0)), others.argmax(axis=0), -1), score

    def duel(
        self,
        at: Pixels,
        rivals: Candidates,
        evidence: Mapping[str, Array],
        met: NDArray[np.int_],
        finalists: tuple[NDArray[np.int_], NDArray[np.int_]],
    ) -> dict[str, Array]:
        """The evidence (1, M) for the pixels ``met`` of N, of whose rivals these two (M,) are left."""
        there = at[0][met], at[1][met]
        about = {name: self.planes[name] for name in PIXEL_FEATURES}
        said = {name: values for name, values in evidence.items() if name not in PIXEL_FEATURES}
        found = sample_planes(about, there, self.likeness.kernels) | self.surroundings.about(there)
        for who, index in zip(("first", "second"), finalists, strict=True):
            plane = (offered[index, met] for offered in (rivals.s, rivals.slope_u, rivals.slope_v))
            its = sample_planes(said, (index, met), self.likeness.kernels) | self.surroundings.relief(
                there, *plane
            )
            found |= {f"{who} {name}": values for name, values in its.items()}
        return {name: values[None] for name, values in found.items()}


def _speaking(
    rivals: Candidates, like: PhotoConsistency, scale: float, auxiliaries: int
) -> Iterator[tuple[str, Array]]:
    """Evidence (9, N) for each rival by name."""
    yield from photo_consistency_features(like, auxiliaries)
    px = np.float32(1 / scale)
    yield "distance", rivals.distance * px
    yield "support", rivals.support
    yield "steeply", np.hypot(rivals.slope_u, rivals.slope_v)
    yield "off its own", _bent(px * (rivals.s - rivals.s[:1]))
    yield "before the farthest", _bent(px * (rivals.s - np.fmin.reduce(rivals.s)))
    yield "behind the nearest", _bent(px * (np.fmax.reduce(rivals.s) - rivals.s))
    own = np.zeros_like(rivals.s)
    own[0] = 1
    yield "its own", own


def _bent(px: Array) -> Array:
    """Large distances by their logarithm, small ones as they are."""
    return np.sign(px) * np.log1p(np.abs(px))
