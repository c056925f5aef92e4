"""Fit the network that finds lumps' outlines (measure/lumps/outlines.py) to simulated captures with truth.

    python tools/train_lumps.py OUT.json CAPTURE[,FRAME]…

Each CAPTURE is what ``beltscape simulate`` wrote of a loaded or an empty belt; it is learnt from as the truth has it,
and, where a FRAME of ``beltscape reconstruct`` is named, as it was matched. Each is shown at three widths of
cell, so that lumps of all sizes are met. Judge with beltscape.evaluate.scores.lumps on captures that are
not among them.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from adam import Layers, Schedule, fitted
from beltscape.evaluate.scores.lumps import true_depth, true_rocks
from beltscape.files.rasters.depth_tiff import read_float_tiff
from beltscape.files.rig_json import read_rig
from beltscape.measure.lumps.features import compute_features
from beltscape.measure.lumps.raster import make_raster
from beltscape.measure.network import Network

CELLS = {400_000: 40_000, 1_600_000: 15_000, 180_000: 15_000}
"""Cells of the raster → how many of them to learn from."""
HIDDEN = (28, 16)
EPOCHS = 9
BATCH = 2048
RATE = 3e-3


def samples(
    capture: Path, frame: Path | None, rng: np.random.Generator
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Features (N, F) and targets (N, 2) of a capture at each width of cell."""
    camera = read_rig(capture / "truth" / "rig.json").core_camera
    truth = next((capture / "truth").glob("*_depth.npz"))
    rock = true_rocks(truth)
    depth = true_depth(truth)
    if frame is not None:
        depth = replace(depth, depth_mm=read_float_tiff(frame / "depth.tiff"))
    for cells, count in CELLS.items():
        raster = make_raster(depth, camera, cells)
        assert raster is not None
        k = raster.factor
        rows, columns = raster.measured.shape
        rocks = rock[k // 2 :: k, k // 2 :: k][:rows, :columns]
        seen = compute_features(raster.height_px, raster.measured).reshape(rows * columns, -1)
        target = np.stack([edges(rocks), rocks >= 0], axis=-1).reshape(-1, 2)
        chosen = rng.permutation(len(seen))[:count]
        yield seen[chosen], target[chosen].astype(np.float32)


def edges(rocks: np.ndarray) -> np.ndarray:
    """Cells with another rock, or none, beside them."""
    found = np.zeros(rocks.shape, bool)
    for one, two in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        apart = rocks[one] != rocks[two]
        found[one] |= apart
        found[two] |= apart
    return found


def fit(x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> Layers:
    """Layers [weights, offsets] of least cross-entropy after a logistic end."""

    def slopes(put: np.ndarray, at: np.ndarray) -> np.ndarray:
        return (1 / (1 + np.exp(-put)) - y[at]) / BATCH

    return fitted(x, y.shape[1], slopes, Schedule(HIDDEN, EPOCHS, BATCH, RATE), rng)


def main(out: str, *captures: str) -> None:
    """Fit and write."""
    rng = np.random.default_rng(1)
    found = []
    for capture in captures:
        folder, _, frame = capture.partition(",")
        found += samples(Path(folder), Path(frame) if frame else None, rng)
        print(capture, flush=True)
    x, y = (np.concatenate([pair[k] for pair in found]) for k in range(2))
    mean, scale = x.mean(axis=0), x.std(axis=0) + np.float32(1e-3)
    layers = tuple((weights, offsets) for weights, offsets in fit((x - mean) / scale, y, rng))
    document = Network(mean, scale, layers).to_document()
    Path(out).write_text(json.dumps(document, separators=(",", ":")) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
