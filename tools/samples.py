"""What matches show and what is true there, of simulated captures; for fit_belief.py."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from beltscape.core.progress import Silent
from beltscape.evaluate.scores.depth import interior_pixels
from beltscape.kernels import load
from beltscape.kernels.candidates import Candidates
from beltscape.stereo.multiview.confidence.estimate import (
    initial_features,
    refined_features,
    with_initial_confidence,
)
from beltscape.stereo.multiview.frame.frame import grid_unit
from beltscape.stereo.multiview.frame.pixels import Pixels
from beltscape.stereo.multiview.frame.windows import windows_for
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.multiview.selection.candidates import UNCERTAIN, CandidateSelector
from beltscape.stereo.multiview.settings import MultiviewSettings
from beltscape.stereo.multiview.state import MatcherState
from lessons import Lesson, lessons

ALONG_MM = 240.0
"""The projector lights little more of the belt."""
SAMPLES, DOUBTS = 20_000, 8_000
"""Of a match's own scene, of the belt beside it a third of that; and of its doubtful pixels."""


@dataclass(frozen=True)
class Sample:
    """Evidence and errors of a match's pixels."""

    names: tuple[str, ...]
    evidence: np.ndarray
    dz_mm: np.ndarray
    ds_px: np.ndarray
    """Of the matcher's grid."""
    mm_per_px: np.ndarray
    interior: np.ndarray
    """Of pixels away from true steps."""
    unseen: np.ndarray
    """Of pixels that no auxiliary truly sees."""
    scale: float
    """Of the grid."""


@dataclass(frozen=True)
class Truth:
    """What a lesson's pixels are, on the matcher's grid."""

    depth_mm: np.ndarray
    scene: np.ndarray
    beside: np.ndarray
    interior: np.ndarray
    unseen: np.ndarray


def pixels(folders: list[Path], what: str) -> Iterator[Sample]:
    """Samples of what the finished surfaces' pixels show: by a first look, or by a closer one."""
    for turn, folder in enumerate(folders):
        for lesson in lessons(folder, turn):
            settings = MultiviewSettings.preset("fast" if what == "glance" else lesson.preset)
            matcher = matcher_of(lesson, settings)
            match = (
                matcher.approach(lesson.frame, lesson.names)
                if what == "impression"
                else matcher.match(lesson.frame, lesson.names, Silent())
            )
            yield _sample(match, lesson, settings)
        print(folder, file=sys.stderr, flush=True)


def _sample(match: MatcherState, lesson: Lesson, settings: MultiviewSettings) -> Sample:
    step = settings.step(lesson.rig.core_camera.size_px[0])
    truth, surface = true(lesson, step), match.refined.surface
    scale = windows_for(match.prepared.core.shape[1]).scale
    at, evidence = _shown(match, truth, scale)
    # of the pixel whose truth is taken, off its block's centre
    aside = (step // 2 - (step - 1) / 2) / step
    s = (surface.s[at] + aside * (surface.slope_u[at] + surface.slope_v[at])).astype(float)
    depth, unit = truth.depth_mm[at].astype(float), unit_of(lesson, settings)
    dz = 1 / (s * unit) - depth
    return Sample(
        tuple(evidence),
        np.stack([np.ravel(values) for values in evidence.values()], -1).astype(np.float32),
        np.full_like(dz, np.inf) if lesson.alien else dz,
        s - 1 / (depth * unit),
        depth * depth * unit,
        truth.interior[at],
        truth.unseen[at],
        scale,
    )


def _shown(match: MatcherState, truth: Truth, scale: float) -> tuple[Pixels, dict[str, np.ndarray]]:
    """Some pixels, and the evidence of them by name."""
    kernels = load()
    if match.contested is None:
        found = initial_features(match, scale, kernels, 0)
    else:
        found, _ = refined_features(match, match.contested, scale, kernels, 0)
    at = _some(truth, np.isfinite(match.refined.surface.s) & (found.seen > 0))
    return at, {name: plane[at] for name, plane in found.planes.items()}


def _some(truth: Truth, asked: np.ndarray) -> Pixels:
    """Of a scene's pixels that are asked, and of those beside it."""
    rng = np.random.default_rng(0)
    wanted = ((truth.scene, SAMPLES), (truth.beside, SAMPLES // 3))
    at = np.concatenate([rng.permutation(np.flatnonzero(where & asked))[:most] for where, most in wanted])
    return np.unravel_index(at, asked.shape)


@dataclass(frozen=True)
class Contest:
    """What a match's doubtful pixels compete in, and what is true."""

    lesson: Lesson
    arena: CandidateSelector
    truth: Truth
    unit: float
    share: float
    """Of them that is taken."""

    def taken(self) -> Iterator[tuple[Pixels, Candidates, dict[str, np.ndarray], np.ndarray]]:
        """Some pixels at a time, their rivals, these' evidence, and how far off they are in px of scale 1 (9, N)."""
        rng = np.random.default_rng(0)
        for rows, columns in self.arena.doubtful():
            use = self.truth.scene[rows, columns] & (rng.random(len(rows)) < self.share)
            at = rows[use], columns[use]
            if not use.any():
                continue
            found, evidence = self.arena.look(at)
            ds = (found.s - 1 / (self.truth.depth_mm[at].astype(float) * self.unit)) / self.arena.scale
            yield at, found, evidence, np.full_like(ds, np.inf) if self.lesson.alien else ds


def contests(folders: list[Path]) -> Iterator[Contest]:
    """Of all lessons."""
    kernels = load()
    for turn, folder in enumerate(folders):
        for lesson in lessons(folder, turn):
            settings = MultiviewSettings.preset(lesson.preset)
            matcher = matcher_of(lesson, settings)
            match = matcher.approach(lesson.frame, lesson.names)
            scale = windows_for(match.prepared.core.shape[1]).scale
            planes = with_initial_confidence(initial_features(match, scale, kernels, 0), scale, kernels, 0)
            truth = true(lesson, 1)
            share = DOUBTS / max(1, int((truth.scene & (planes["impression"] < UNCERTAIN)).sum()))
            arena = CandidateSelector.of(match.refined.surface, planes, match.prepared, scale, kernels, 0)
            yield Contest(lesson, arena, truth, unit_of(lesson, settings), share)
        print(folder, file=sys.stderr, flush=True)


def matcher_of(lesson: Lesson, settings: MultiviewSettings) -> MultiviewReconstructor:
    """Of the lesson's rig, auxiliaries and depths."""
    return MultiviewReconstructor(lesson.rig, lesson.near_far_mm, settings, auxiliaries=lesson.names)


def unit_of(lesson: Lesson, settings: MultiviewSettings) -> float:
    """1/mm per px of the matcher's grid."""
    return grid_unit(lesson.rig, lesson.names, settings.step(lesson.rig.core_camera.size_px[0]))


def true(lesson: Lesson, step: int) -> Truth:
    """The truth of every so-manieth pixel."""
    height, width = (size // step for size in lesson.depth_mm.shape)
    inside = slice(step // 2, height * step, step), slice(step // 2, width * step, step)
    depth, label = lesson.depth_mm[inside], lesson.label[inside]
    near = np.abs(lesson.rig.core_camera.rays()[inside][..., 1] * depth) <= ALONG_MM
    scene = label >= 10 if (label >= 10).any() else label == (2 if (label == 2).any() else 1)
    return Truth(
        depth,
        scene & near,
        ~scene & near & ((label == 1) | (label == 2)),
        interior_pixels(lesson.depth_mm.astype(float))[inside],
        lesson.views[inside] == 0,
    )
