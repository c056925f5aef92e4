"""What scrutiny is fitted to: tiles of simulated captures' doubtful pixels, with what is true of them.

    python tools/doubts.py OUT CAPTURE…

CAPTURE is as for fit_belief.py; OUT takes a file of each.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from beltscape.core.progress import Silent
from beltscape.kernels import load
from beltscape.stereo.multiview.confidence.estimate import refined_features
from beltscape.stereo.multiview.confidence.message_passing import (
    FIRST_UNCERTAIN,
    assign_addresses,
    neighbour_addresses,
)
from beltscape.stereo.multiview.confidence.refiner import RefinementInputs, mask_accepted, mask_uncertain
from beltscape.stereo.multiview.frame.windows import windows_for
from beltscape.stereo.multiview.networks import load_network
from beltscape.stereo.multiview.settings import MultiviewSettings
from lessons import Lesson, lessons
from samples import Truth, matcher_of, true, unit_of

TILE_PX, MARGIN_PX = 128, 3
"""Side of a tile, and how far about it pixels are heard, at scale 1."""
ENOUGH = 50_000
"""Doubtful pixels of a lesson."""
BESIDE = 1 / 3
"""What a pixel of the belt beside a scene counts for."""


class Tile(NamedTuple):
    """Doubtful pixels (N,), those of a margin among them; what is off is in px of scale 1."""

    evidence: np.ndarray
    """(N, n) float16."""
    near: np.ndarray
    """(9, N) addresses within the tile."""
    off_px: np.ndarray
    """How much nearer than they are; infinite where what is seen is not there."""
    mm_per_px: np.ndarray
    weight: np.ndarray
    """0 in the margin, where no auxiliary is thought to see the pixel, and off the projector's light."""
    unseen: np.ndarray
    """That no auxiliary truly sees."""


FIELDS = Tile._fields


def tiles(folder: Path, turn: int) -> Iterator[tuple[tuple[str, ...], Tile]]:
    """The evidence's names, and tiles of a capture's lessons."""
    for lesson in lessons(folder, turn):
        settings = MultiviewSettings.preset(lesson.preset)
        match = matcher_of(lesson, settings).match(lesson.frame, lesson.names, Silent())
        if match.contested is None:
            continue
        scale = windows_for(match.prepared.core.shape[1]).scale
        found, scrutiny = refined_features(match, match.contested, scale, load(), 0)
        logit, _ = load_network("belief").answers(found.planes, load(), 0)
        truth, unit = true(lesson, 1), unit_of(lesson, settings)
        weight = np.where(truth.scene, 1, BESIDE * truth.beside) * (found.seen > 0)
        doubts = Doubts(lesson, scrutiny, logit, truth, unit, weight.astype(np.float32))
        yield from doubts.tiles()


@dataclass(frozen=True)
class Doubts:
    """Of a lesson."""

    lesson: Lesson
    scrutiny: RefinementInputs
    logit: np.ndarray
    truth: Truth
    unit: float
    weight: np.ndarray

    def tiles(self) -> Iterator[tuple[tuple[str, ...], Tile]]:
        """Some, until there are enough doubtful pixels."""
        scale = self.scrutiny.surroundings.scale
        asked = mask_uncertain(self.logit) & np.isfinite(self.scrutiny.surface.s)
        side, margin = round(TILE_PX * scale), MARGIN_PX * self.scrutiny.surroundings.step
        corners = [(v, u) for v in range(0, asked.shape[0], side) for u in range(0, asked.shape[1], side)]
        taken = 0
        for corner in np.random.default_rng(0).permutation(corners):
            inner = np.zeros_like(asked)
            inner[tuple(slice(at, at + side) for at in corner)] = True
            wide = np.zeros_like(asked)
            wide[tuple(slice(max(0, at - margin), at + side + margin) for at in corner)] = True
            weighed = self.weight * inner
            if not (weighed[asked] > 0).any():
                continue
            yield self.tile(asked & wide, weighed)
            taken += np.count_nonzero(weighed[asked])
            if taken >= ENOUGH:
                return

    def tile(self, asked: np.ndarray, weight: np.ndarray) -> tuple[tuple[str, ...], Tile]:
        """Of the pixels asked."""
        scrutiny, around = self.scrutiny, self.scrutiny.surroundings
        at = np.nonzero(asked)
        shown = scrutiny.look(at, self.logit[at])
        depth = self.truth.depth_mm[at].astype(float)
        off = (scrutiny.surface.s[at] - 1 / (depth * self.unit)) / around.scale
        alien = np.full_like(off, np.inf)
        return tuple(shown), Tile(
            np.concatenate(list(shown.values())).T.astype(np.float16),
            neighbour_addresses(assign_addresses(asked, mask_accepted(self.logit)), asked, around.step),
            (alien if self.lesson.alien else off).astype(np.float32),
            (depth * depth * self.unit * around.scale).astype(np.float32),
            weight[at],
            self.truth.unseen[at],
        )


def joined(some: list[Tile]) -> Tile:
    """Tiles as one: addresses of asked pixels move on."""
    from_where = np.cumsum([0, *(len(each.off_px) for each in some)])
    parts = {name: [getattr(each, name) for each in some] for name in FIELDS}
    parts["near"] = [
        np.where(each.near >= FIRST_UNCERTAIN, each.near + start, each.near)
        for each, start in zip(some, from_where, strict=False)
    ]
    return Tile(
        **{name: np.concatenate(part, axis=-1 if name == "near" else 0) for name, part in parts.items()}
    )


def write_tiles(path: Path, folder: Path, turn: int) -> int:
    """A capture's tiles as a file; how many."""
    found = list(tiles(folder, turn))
    parts = {
        f"{i} {name}": part
        for i, (_, tile) in enumerate(found)
        for name, part in zip(FIELDS, tile, strict=True)
    }
    np.savez(path, names=found[0][0] if found else (), **parts)
    return len(found)


def read_tiles(path: Path) -> tuple[tuple[str, ...], list[Tile]]:
    """The evidence's names, and a capture's tiles."""
    kept = np.load(path)
    number = (len(kept.files) - 1) // len(FIELDS)
    return tuple(kept["names"]), [Tile(*(kept[f"{i} {name}"] for name in FIELDS)) for i in range(number)]


def main() -> None:
    """Match, look, write."""
    out = Path(sys.argv[1])
    out.mkdir(exist_ok=True)
    for turn, folder in enumerate(map(Path, sys.argv[2:])):
        number = write_tiles(out / f"{turn:03d}.npz", folder, turn)
        print(folder, number, "tiles", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
