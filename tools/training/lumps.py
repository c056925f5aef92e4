"""Recipe of the network that finds lumps' outlines."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera
from beltscape.files.rig_json import read_rig
from beltscape.learned.network import Network
from beltscape.measure.lumps.features import compute_features, make_raster
from training.cache import SampleCache
from training.losses import make_cross_entropy
from training.perceptron import Schedule, fit_perceptron
from training.reconstructions import reconstruct_capture
from training.samples.packings import simulate_packing

CELLS = {400_000: 40_000, 1_600_000: 15_000, 180_000: 15_000}
"""Cells of the raster → number of them drawn from a capture; three widths, so that lumps of all sizes occur."""
SCHEDULE = Schedule((28, 16), 9, 2048)
PACKINGS, PACKED_CELLS = 640, 12_000
"""Number of simulated packings of bodies, and of cells at most drawn from each."""
_PLANE = 0.15
"""Compressed height of the chords over a cell, in cells, up to which its surroundings are a plane; above noise."""
_TRUE_SIGMA_MM = 0.01
"""σ of a true depth: negligible."""


def collect_lumps(captures: list[Path], cache: SampleCache) -> dict[str, np.ndarray]:
    """Return the samples of cells with their outlines and lumps."""
    return cache.collect("lumps", captures, _draw)


def train_lumps(captures: list[Path], cache: SampleCache) -> Network:
    """Train the logits of the probabilities of an outline and of a lump, on true, measured and simulated depth."""
    samples = collect_lumps(captures, cache)
    names = tuple(map(str, samples["names"]))
    parts = [(samples["features"], samples["target"]), *map(_draw_packing, range(PACKINGS))]
    features, target = (np.concatenate(part) for part in zip(*parts, strict=True))
    uneven = mask_uneven(names, features)
    loss = make_cross_entropy(target[uneven])
    return fit_perceptron(names, ("outline", "lump"), features[uneven], loss, SCHEDULE)


def mask_uneven(names: tuple[str, ...], features: np.ndarray) -> np.ndarray:
    """Return the mask (N,) of cells whose surroundings are uneven.

    Where all around is a plane, the features do not tell the middle of a flat top from the belt. Lumps are decided
    along their rims, so these cells are left out: else the network learns from the many cells of the belt that
    whatever is smooth is no lump.
    """
    chords = [i for i, name in enumerate(names) if "chord over" in name]
    return np.abs(features[:, chords]).max(axis=1) > _PLANE


def _draw_packing(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return features (N, F) and targets (N, 2) of cells of a simulated packing, of bodies and ground alike many.

    Along the rim of a lone body both are as likely, whatever share of the view it covers.
    """
    rng = np.random.default_rng(seed)
    height, measured, body = simulate_packing(rng)
    names, features, target = _draw_table(height, measured, body, body.size, rng)
    uneven = mask_uneven(names, features)
    drawn = [np.flatnonzero(uneven & (target[:, 1] == kind))[: PACKED_CELLS // 2] for kind in (False, True)]
    equal = min(map(len, drawn))
    drawn = np.concatenate([one[:equal] for one in drawn])
    return features[drawn], target[drawn]


def _draw(capture: Path, _turn: int) -> dict[str, np.ndarray]:
    path = next((capture / "truth").glob("*_depth.npz"))
    if path.stem == "module_depth":
        return {}  # its steps are neither lumps nor ground
    truth, rocks = _read_truth(path)
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
    camera: Camera,
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
        yield _draw_table(raster.height_px, raster.measured, rock, count, rng)


def _draw_table(
    height_px: np.ndarray, measured: np.ndarray, body: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Return names, features (N, F) and targets (N, 2) of ``count`` cells, given the body (R, C) in each."""
    features = compute_features(height_px, measured)
    target = np.stack([mask_outlines(body), body >= 0], axis=-1).reshape(-1, 2)
    drawn = rng.permutation(body.size)[:count]
    table = np.stack([plane.ravel()[drawn] for plane in features.values()], axis=-1)
    return tuple(features), table, target[drawn]


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
