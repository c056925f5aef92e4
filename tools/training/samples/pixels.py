"""Features and errors of the pixels of matched training frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from beltscape.core.progress import Silent
from beltscape.evaluate.depth_scores import interior_mask
from beltscape.kernels.selection import Candidates
from beltscape.stereo.multiview.candidates import UNCERTAIN, CandidateSelector
from beltscape.stereo.multiview.features import (
    ConfidenceInputs,
    MatcherState,
    compute_initial_features,
    compute_selection_features,
)
from beltscape.stereo.multiview.parallel import Pixels
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.multiview.refined_features import RefinementInputs
from beltscape.stereo.settings import MultiviewSettings
from training.samples.augmentation import TrainingFrame, training_frames

ALONG_MM = 240.0
"""The projector lights little more of the belt."""
SAMPLES, UNCERTAIN_SAMPLES = 20_000, 8_000
"""Pixels of a frame's scene (of the belt beside it a third of that), and its uncertain pixels."""


@dataclass(frozen=True)
class Sample:
    """Features and errors of some pixels of a frame."""

    names: tuple[str, ...]
    features: np.ndarray
    dz_mm: np.ndarray
    ds_px: np.ndarray
    """Of the matcher's grid."""
    mm_per_px: np.ndarray
    interior: np.ndarray
    """Of pixels away from true steps."""
    occluded: np.ndarray
    """Of pixels that no auxiliary truly sees."""
    dark: np.ndarray
    """Of pixels that the projector does not light."""
    scale: float
    """Of the grid."""


@dataclass(frozen=True)
class Truth:
    """The truth of a frame's pixels on the matcher's grid."""

    depth_mm: np.ndarray
    scene: np.ndarray
    beside: np.ndarray
    interior: np.ndarray
    occluded: np.ndarray
    dark: np.ndarray


def draw_pixel_samples(folder: Path, turn: int, network: str) -> Iterator[Sample]:
    """Yield samples of a capture's training frames with the features of a network: initial or refined ones."""
    for training in training_frames(folder, turn):
        settings = MultiviewSettings.preset("fast" if network == "fast_confidence" else "standard")
        matcher = make_matcher(training, settings)
        match = (
            matcher.solve_pyramid(training.frame, training.names)
            if network == "initial_confidence"
            else matcher.match(training.frame, training.names, Silent())
        )
        yield _sample(match, training, settings)


def _sample(match: MatcherState, training: TrainingFrame, settings: MultiviewSettings) -> Sample:
    step = settings.step(training.rig.core_camera.size_px[0])
    truth, surface = read_truth(training, step), match.solution.surface
    context = match.prepared.context
    at, features = _select_features(match, truth)
    # the pixel whose truth is taken lies off its block's centre
    aside = (step // 2 - (step - 1) / 2) / step
    s = (surface.s[at] + aside * (surface.slope_u[at] + surface.slope_v[at])).astype(float)
    depth, unit = truth.depth_mm[at].astype(float), context.inverse_depth_scale
    dz = 1 / (s * unit) - depth
    return Sample(
        tuple(features),
        np.stack([np.ravel(values) for values in features.values()], -1).astype(np.float32),
        np.full_like(dz, np.inf) if training.is_false else dz,
        s - 1 / (depth * unit),
        depth * depth * unit,
        truth.interior[at],
        truth.occluded[at],
        truth.dark[at],
        context.scale,
    )


def _select_features(match: MatcherState, truth: Truth) -> tuple[Pixels, dict[str, np.ndarray]]:
    """Return some pixels, and their features by name."""
    inputs = ConfidenceInputs.from_state(match)
    planes = compute_initial_features(inputs)
    if match.selection is not None:
        planes = RefinementInputs.from_selection(inputs, planes, match.selection).planes
    at = _draw_pixels(truth, np.isfinite(match.solution.surface.s) & (inputs.visible > 0))
    return at, {name: plane[at] for name, plane in planes.items()}


def _draw_pixels(truth: Truth, mask: np.ndarray) -> Pixels:
    """Draw pixels of the mask from the scene and from the belt beside it."""
    rng = np.random.default_rng(0)
    wanted = ((truth.scene, SAMPLES), (truth.beside, SAMPLES // 3))
    at = np.concatenate([rng.permutation(np.flatnonzero(where & mask))[:most] for where, most in wanted])
    rows, columns = np.unravel_index(at, mask.shape)
    return rows, columns


@dataclass(frozen=True)
class SelectionSamples:
    """The candidate selection of a training frame, and its truth."""

    training: TrainingFrame
    selector: CandidateSelector
    truth: Truth
    unit: float
    share: float
    """Of the uncertain pixels that is drawn."""

    def draw(self) -> Iterator[tuple[Pixels, Candidates, dict[str, np.ndarray], np.ndarray]]:
        """Yield pixels, their candidates, the features (1, M) of those with a surface, and errors (9, N) in px."""
        rng = np.random.default_rng(0)
        for rows, columns in self.selector.find_uncertain_pixels():
            use = self.truth.scene[rows, columns] & (rng.random(len(rows)) < self.share)
            at = rows[use], columns[use]
            if not use.any():
                continue
            found, features = self.selector.find_candidates(at)
            if not features:
                continue
            ds = (found.s - 1 / (self.truth.depth_mm[at].astype(float) * self.unit)) / self.selector.scale
            yield at, found, features, np.full_like(ds, np.inf) if self.training.is_false else ds


def draw_selection_samples(folder: Path, turn: int) -> Iterator[SelectionSamples]:
    """Yield the candidate selections of a capture's training frames."""
    for training in training_frames(folder, turn):
        settings = MultiviewSettings()
        matcher = make_matcher(training, settings)
        match = matcher.solve_pyramid(training.frame, training.names)
        context = match.prepared.context
        planes = compute_selection_features(ConfidenceInputs.from_state(match))
        truth = read_truth(training, 1)
        uncertain = truth.scene & (planes["initial confidence"] < UNCERTAIN)
        share = UNCERTAIN_SAMPLES / max(1, int(uncertain.sum()))
        selector = CandidateSelector.from_surface(match.solution.surface, planes, match.prepared)
        yield SelectionSamples(training, selector, truth, context.inverse_depth_scale, share)


def make_matcher(training: TrainingFrame, settings: MultiviewSettings) -> MultiviewReconstructor:
    """Return the matcher for the frame's rig, auxiliaries and depth range."""
    return MultiviewReconstructor(training.rig, training.near_far_mm, settings, auxiliaries=training.names)


def read_truth(training: TrainingFrame, step: int) -> Truth:
    """Return the truth of every ``step``-th pixel."""
    height, width = (size // step for size in training.depth_mm.shape)
    inside = slice(step // 2, height * step, step), slice(step // 2, width * step, step)
    depth, label = training.depth_mm[inside], training.label[inside]
    near = np.abs(training.rig.core_camera.rays()[inside][..., 1] * depth) <= ALONG_MM
    scene = mask_scene(label)
    return Truth(
        depth,
        scene & near,
        ~scene & near & ((label == 1) | (label == 2)),
        interior_mask(training.depth_mm.astype(float))[inside],
        training.views[inside] == 0,
        ~training.lit[inside],
    )


def mask_scene(label: np.ndarray) -> np.ndarray:
    """Return the mask of the material or the module, or of the belt where there is neither."""
    return label >= 10 if (label >= 10).any() else label == (2 if (label == 2).any() else 1)
