"""Train the network that finds lumps' outlines (measure/lumps/outlines.py) on simulated captures with truth.

    python tools/train_lumps.py OUT.json CAPTURE[,FRAME]…

Each CAPTURE is what ``beltscape simulate`` wrote of a loaded or an empty belt. The network is trained on its true
depth or, where a FRAME of ``beltscape reconstruct`` is named, on that frame's depth. Every capture is used at three
widths of cell, so that lumps of all sizes occur. Assess the result with beltscape.evaluate.scores.lumps on captures
that are not among them.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from adam import Layers, Schedule, fit_layers
from beltscape.core.depth import DepthMap
from beltscape.files.rasters.depth_tiff import read_float_tiff
from beltscape.files.rig_json import read_rig
from beltscape.measure.lumps.features import compute_features
from beltscape.measure.lumps.raster import make_raster
from beltscape.measure.network import Network

CELLS = {400_000: 40_000, 1_600_000: 15_000, 180_000: 15_000}
"""Cells of the raster → number of them drawn from a capture."""
HIDDEN = (28, 16)
EPOCHS = 9
BATCH = 2048
RATE = 3e-3


def draw_samples(
    capture: Path, frame: Path | None, rng: np.random.Generator
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield features (N, F) and targets (N, 2) of a capture at each width of cell."""
    camera = read_rig(capture / "truth" / "rig.json").core_camera
    depth, rock = read_truth(next((capture / "truth").glob("*_depth.npz")))
    if frame is not None:
        depth = replace(depth, depth_mm=read_float_tiff(frame / "depth.tiff"))
    for cells, count in CELLS.items():
        raster = make_raster(depth, camera, cells)
        assert raster is not None
        k = raster.factor
        rows, columns = raster.measured.shape
        rocks = rock[k // 2 :: k, k // 2 :: k][:rows, :columns]
        features = compute_features(raster.height_px, raster.measured).reshape(rows * columns, -1)
        target = np.stack([mask_outlines(rocks), rocks >= 0], axis=-1).reshape(-1, 2)
        drawn = rng.permutation(len(features))[:count]
        yield features[drawn], target[drawn].astype(np.float32)


def read_truth(path: Path) -> tuple[DepthMap, np.ndarray]:
    """Return the true depth with a negligible σ, and the number (H, W) of the rock in each pixel, -1: none."""
    with np.load(path) as arrays:
        depth = arrays["depth_mm"].astype(np.float32)
        rock = arrays["rock"].astype(np.int32) if "rock" in arrays else np.full(depth.shape, -1, np.int32)
    valid = np.isfinite(depth)
    sigma = np.where(valid, 0.01, np.nan).astype(np.float32)
    return DepthMap(depth, sigma, valid.astype(np.uint8), valid.astype(np.float32)), rock


def mask_outlines(rocks: np.ndarray) -> np.ndarray:
    """Return the mask of the cells with another rock, or none, beside them."""
    mask = np.zeros(rocks.shape, bool)
    for one, two in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        apart = rocks[one] != rocks[two]
        mask[one] |= apart
        mask[two] |= apart
    return mask


def fit_classifier(x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> Layers:
    """Return the layers of least cross-entropy; their outputs are logits."""

    def gradient(logits: np.ndarray, at: np.ndarray) -> np.ndarray:
        return (1 / (1 + np.exp(-logits)) - y[at]) / len(at)

    return fit_layers(x, y.shape[1], gradient, Schedule(HIDDEN, EPOCHS, BATCH, RATE), rng)


def main(out: str, *captures: str) -> None:
    """Draw samples, train the network and write it."""
    rng = np.random.default_rng(1)
    samples: list[tuple[np.ndarray, np.ndarray]] = []
    for capture in captures:
        folder, _, frame = capture.partition(",")
        samples += draw_samples(Path(folder), Path(frame) if frame else None, rng)
        print(capture, flush=True)
    x, y = (np.concatenate([pair[k] for pair in samples]) for k in range(2))
    mean, scale = x.mean(axis=0), x.std(axis=0) + np.float32(1e-3)
    layers = tuple((weights, offsets) for weights, offsets in fit_classifier((x - mean) / scale, y, rng))
    document = Network(mean, scale, layers).to_document()
    Path(out).write_text(json.dumps(document, separators=(",", ":")) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
