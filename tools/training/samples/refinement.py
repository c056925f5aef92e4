"""Samples of the refinement network: tiles of uncertain pixels of simulated captures, with their truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from beltscape.core.progress import Silent
from beltscape.kernels import load
from beltscape.learned.registry import load_network
from beltscape.stereo.multiview.estimate import (
    FIRST_UNCERTAIN,
    RefinementInputs,
    assign_addresses,
    gather_neighbour_addresses,
    mask_accepted,
    mask_uncertain,
)
from beltscape.stereo.multiview.features import ConfidenceInputs, compute_initial_features
from beltscape.stereo.settings import MultiviewSettings
from training.cache import write_whole
from training.samples.augmentation import TrainingFrame, training_frames
from training.samples.pixels import Truth, make_matcher, read_truth

TILE_PX, MARGIN_PX = 128, 3
"""Side of a tile, and of the margin whose pixels pass messages into it, at scale 1."""
ENOUGH = 50_000
"""Uncertain pixels of a training frame."""
BESIDE = 1 / 3
"""Weight of a pixel of the belt beside a scene."""


class Tile(NamedTuple):
    """Uncertain pixels (N,), including those of the margin; errors are in px of scale 1."""

    features: np.ndarray
    """(N, n) float16."""
    neighbours: np.ndarray
    """(9, N) addresses within the tile."""
    off_px: np.ndarray
    """Error of s; infinite where every surface is false."""
    mm_per_px: np.ndarray
    weight: np.ndarray
    """0 in the margin, where no auxiliary sees the matched surface, and outside the projector's light."""
    occluded: np.ndarray
    """Pixels that no auxiliary truly sees."""
    dark: np.ndarray
    """Pixels that the projector does not light."""


FIELDS = Tile._fields


def draw_tiles(folder: Path, turn: int) -> Iterator[tuple[tuple[str, ...], Tile]]:
    """Yield the features' names and tiles of a capture's training frames."""
    for training in training_frames(folder, turn):
        settings = MultiviewSettings()
        match = make_matcher(training, settings).match(training.frame, training.names, Silent())
        if match.selection is None:
            continue
        surface = ConfidenceInputs.from_state(match)
        features = compute_initial_features(surface)
        inputs = RefinementInputs.from_selection(surface, features, match.selection)
        logit, _ = load_network("confidence").evaluate(inputs.planes, load(), 0)
        truth, unit = read_truth(training, 1), match.prepared.context.inverse_depth_scale
        weight = np.where(truth.scene, 1, BESIDE * truth.beside) * (surface.visible > 0)
        frame = UncertainFrame(training, inputs, logit, truth, unit, weight.astype(np.float32))
        yield from frame.tiles()


@dataclass(frozen=True)
class UncertainFrame:
    """A matched training frame whose uncertain pixels are divided into tiles."""

    training: TrainingFrame
    inputs: RefinementInputs
    logit: np.ndarray
    truth: Truth
    unit: float
    weight: np.ndarray

    def tiles(self) -> Iterator[tuple[tuple[str, ...], Tile]]:
        """Yield tiles in random order until there are enough uncertain pixels."""
        scale = self.inputs.context.scale
        uncertain = mask_uncertain(self.logit) & np.isfinite(self.inputs.surface.s)
        side, margin = round(TILE_PX * scale), MARGIN_PX * self.inputs.neighbourhood.spacing
        corners = [
            (v, u) for v in range(0, uncertain.shape[0], side) for u in range(0, uncertain.shape[1], side)
        ]
        taken = 0
        for corner in np.random.default_rng(0).permutation(corners):
            inner = np.zeros_like(uncertain)
            inner[tuple(slice(at, at + side) for at in corner)] = True
            wide = np.zeros_like(uncertain)
            wide[tuple(slice(max(0, at - margin), at + side + margin) for at in corner)] = True
            inner_weight = self.weight * inner
            if not (inner_weight[uncertain] > 0).any():
                continue
            yield self.tile(uncertain & wide, inner_weight)
            taken += np.count_nonzero(inner_weight[uncertain])
            if taken >= ENOUGH:
                return

    def tile(self, uncertain: np.ndarray, weight: np.ndarray) -> tuple[tuple[str, ...], Tile]:
        """Return the features' names and the tile of the uncertain pixels of a mask."""
        inputs, scale = self.inputs, self.inputs.context.scale
        at = np.nonzero(uncertain)
        features = inputs.compute_features(at, self.logit[at])
        depth = self.truth.depth_mm[at].astype(float)
        off = (inputs.surface.s[at] - 1 / (depth * self.unit)) / scale
        false = np.full_like(off, np.inf)
        return tuple(features), Tile(
            np.concatenate(list(features.values())).T.astype(np.float16),
            gather_neighbour_addresses(
                assign_addresses(uncertain, mask_accepted(self.logit)),
                uncertain,
                inputs.neighbourhood.spacing,
            ),
            (false if self.training.is_false else off).astype(np.float32),
            (depth * depth * self.unit * scale).astype(np.float32),
            weight[at],
            self.truth.occluded[at],
            self.truth.dark[at],
        )


def join_tiles(some: list[Tile]) -> Tile:
    """Return several tiles as one, with the addresses of uncertain pixels renumbered."""
    firsts = np.cumsum([0, *(len(each.off_px) for each in some)])
    parts = {name: [getattr(each, name) for each in some] for name in FIELDS}
    parts["neighbours"] = [
        np.where(each.neighbours >= FIRST_UNCERTAIN, each.neighbours + start, each.neighbours)
        for each, start in zip(some, firsts, strict=False)
    ]
    return Tile(
        **{name: np.concatenate(part, axis=-1 if name == "neighbours" else 0) for name, part in parts.items()}
    )


def write_tiles(path: Path, folder: Path, turn: int) -> int:
    """Write a capture's tiles to a file; return their number."""
    found = list(draw_tiles(folder, turn))
    parts: dict[str, Any] = {
        f"{i} {name}": part
        for i, (_, tile) in enumerate(found)
        for name, part in zip(FIELDS, tile, strict=True)
    }
    write_whole(path, {"names": np.array(found[0][0] if found else ()), **parts})
    return len(found)


def read_tiles(path: Path) -> tuple[tuple[str, ...], list[Tile]]:
    """Return the features' names and a capture's tiles."""
    kept = np.load(path)
    number = (len(kept.files) - 1) // len(FIELDS)
    return tuple(kept["names"]), [Tile(*(kept[f"{i} {name}"] for name in FIELDS)) for i in range(number)]
