"""Recipe of the network that finds lumps' outlines."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.files.rig_json import read_rig
from beltscape.learned.network import Network
from beltscape.measure.lumps.features import compute_features
from beltscape.measure.lumps.raster import make_raster
from training.cache import SampleCache
from training.losses import make_cross_entropy
from training.perceptron import Schedule, fit_perceptron
from training.reconstructions import reconstruct_capture

CELLS = {400_000: 40_000, 1_600_000: 15_000, 180_000: 15_000}
"""Cells of the raster → number of them drawn from a capture; three widths, so that lumps of all sizes occur."""
SCHEDULE = Schedule((28, 16), 9, 2048)
_PLANE = 0.15
"""Compressed height of the chords over a cell, in cells, up to which its surroundings are a plane; above noise."""
_TRUE_SIGMA_MM = 0.01
"""σ of a true depth: negligible."""


def collect_lumps(captures: list[Path], cache: SampleCache) -> dict[str, np.ndarray]:
    """Return the samples of cells with their outlines and lumps."""
    return cache.collect("lumps", captures, lambda folder, _: _draw(folder))


def train_lumps(captures: list[Path], cache: SampleCache) -> Network:
    """Train the logits of the probabilities of an outline and of a lump, on true and on measured depth."""
    samples = collect_lumps(captures, cache)
    names = tuple(map(str, samples["names"]))
    uneven = mask_uneven(names, samples["features"])
    loss = make_cross_entropy(samples["target"][uneven])
    return fit_perceptron(names, ("outline", "lump"), samples["features"][uneven], loss, SCHEDULE)


def mask_uneven(names: tuple[str, ...], features: np.ndarray) -> np.ndarray:
    """Return the mask (N,) of cells whose surroundings are uneven.

    Where all around is a plane, the features do not tell the middle of a flat top from the belt. Lumps are decided
    along their rims, so these cells are left out: else the network learns from the many cells of the belt that
    whatever is smooth is no lump.
    """
    chords = [i for i, name in enumerate(names) if "chord over" in name]
    return np.abs(features[:, chords]).max(axis=1) > _PLANE


def _draw(capture: Path) -> dict[str, np.ndarray]:
    truth, rocks = _read_truth(next((capture / "truth").glob("*_depth.npz")))
    camera = read_rig(capture / "truth" / "rig.json").core_camera
    rng = np.random.default_rng(1)
    parts = [
        part
        for depth in (truth, reconstruct_capture(capture))
        if depth is not None
        for part in _draw_cells(depth, rocks, camera, rng)
    ]
    if not parts:
        return {}
    return {
        "names": np.array(parts[0][0]),
        "features": np.concatenate([features for _, features, _ in parts]),
        "target": np.concatenate([target for _, _, target in parts]),
    }


def _draw_cells(
    depth: DepthMap,
    rocks: np.ndarray,
    camera,
    rng: np.random.Generator,
) -> Iterator[tuple[tuple[str, ...], np.ndarray, np.ndarray]]:
    """Yield names, features (N, F) and targets (N, 2) at each width of cell."""
    for cells, count in CELLS.items():
        raster = make_raster(depth, camera, cells)
        if raster is None:
            continue
        k = raster.factor
        rows, columns = raster.measured.shape
        rock = rocks[k // 2 :: k, k // 2 :: k][:rows, :columns]
        features = compute_features(raster.height_px, raster.measured)
        target = np.stack([mask_outlines(rock), rock >= 0], axis=-1).reshape(-1, 2)
        drawn = rng.permutation(rows * columns)[:count]
        table = np.stack([plane.ravel()[drawn] for plane in features.values()], axis=-1)
        yield tuple(features), table, target[drawn]


def _read_truth(path: Path) -> tuple[DepthMap, np.ndarray]:
    """Return the true depth with a negligible σ, and the number (H, W) of the rock in each pixel, -1: none."""
    with np.load(path) as arrays:
        depth = arrays["depth_mm"].astype(np.float32)
        rock = arrays["rock"].astype(np.int32) if "rock" in arrays else np.full(depth.shape, -1, np.int32)
    valid = np.isfinite(depth)
    sigma = np.where(valid, _TRUE_SIGMA_MM, np.nan).astype(np.float32)
    return DepthMap(depth, sigma, valid.astype(np.uint8), valid.astype(np.float32)), rock


def mask_outlines(rocks: np.ndarray) -> np.ndarray:
    """Return the mask of the cells with another rock, or none, beside them."""
    mask = np.zeros(rocks.shape, bool)
    for one, two in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        apart = rocks[one] != rocks[two]
        mask[one] |= apart
        mask[two] |= apart
    return mask
