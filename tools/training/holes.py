"""Recipe of the network that fills holes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from beltscape.core.errors import ReconstructionError
from beltscape.kernels.holes import HOLE_FEATURES
from beltscape.learned.network import LOG_VARIANCE, Network
from training.belts import MATERIALS
from training.cache import SampleCache
from training.losses import make_mean_and_variance
from training.perceptron import Schedule, average_networks, compute_limits, fit_perceptron
from training.reconstructions import reconstruct_capture
from training.samples.belts import draw_belt_samples, draw_frame_samples
from training.samples.holes import Samples, collect_samples, draw_hole_samples
from training.samples.surfaces import simulate_bodies_seen, simulate_smooth_surface

SCHEDULE = Schedule((16, 8), epochs=6, batch=2048, decay=1e-5)
CAPTURES = 45
"""Number of captures, the first and smallest: moving heaps show more materials for less."""
MAX_TARGET = 5.0
"""Absolute value to which targets are clipped."""
VARIANCE_WEIGHT = 0.1
"""Weight of the likelihood of the variance, relative to the squared error of the mean."""
MEMBERS = 3
"""Size of the ensemble: networks from different initial weights, whose outputs are averaged."""
PRESETS = "fast", "standard"
"""Presets that match moving heaps, in turn."""
SURFACES = 40
"""Number of simulated smooth surfaces, and of those with bodies, which keep the prediction in such holes unbiased."""


def collect_holes(captures: list[Path], heaps: list[Path], cache: SampleCache) -> dict[str, np.ndarray]:
    """Return the samples of hole cells: of the captures, and of moving heaps, of a frame and of all frames fused."""
    frames = cache.collect("holes", captures[:CAPTURES], _draw)
    fused = cache.collect("heap_holes", heaps, _draw_heap)
    return {
        key: frames[key] if key == "names" else np.concatenate([frames[key], fused[key]]) for key in frames
    }


def train_holes(captures: list[Path], heaps: list[Path], cache: SampleCache) -> Network:
    """Train the mean by least squares, and the log variance by the residuals' likelihood."""
    samples = collect_holes(captures, heaps, cache)
    names = tuple(map(str, samples.pop("names")))
    parts = [samples, *_draw_simulated()]
    x, y, weight = (np.concatenate([part[key] for part in parts if part]) for key in ("x", "y", "weight"))
    y = np.clip(y, -MAX_TARGET, MAX_TARGET)
    loss = make_mean_and_variance(y, weight / weight.mean(), VARIANCE_WEIGHT, LOG_VARIANCE)
    limits = compute_limits(x)
    outputs = ("mean", "log variance")
    members = [
        fit_perceptron(names, outputs, x, loss, SCHEDULE, limits=limits, seed=seed) for seed in range(MEMBERS)
    ]
    return average_networks(members)


def _draw_simulated() -> Iterator[dict[str, np.ndarray]]:
    """Yield the samples of simulated surfaces."""
    for seed in range(SURFACES):
        for simulate in (simulate_smooth_surface, simulate_bodies_seen):
            load, truth = simulate(np.random.default_rng(seed))
            yield _as_arrays(collect_samples(load, truth, 1.0))


def _draw(capture: Path, _turn: int) -> dict[str, np.ndarray]:
    if not next((capture / "truth").glob("*_load.npz"), None):
        return {}
    depth = reconstruct_capture(capture)
    if depth is None:
        return {}
    samples = draw_hole_samples(capture, depth)
    arrays = _as_arrays(samples)
    return {"names": np.array(samples.names), **arrays} if arrays else {}


def _draw_heap(heap: Path, turn: int) -> dict[str, np.ndarray]:
    """Return the samples of a moving heap, none where nothing of it is measured.

    Every second one of each material is matched by the other preset.
    """
    preset = PRESETS[(turn + turn // len(MATERIALS)) % len(PRESETS)]
    try:
        parts = [_as_arrays(draw(heap, preset)) for draw in (draw_belt_samples, draw_frame_samples)]
    except ReconstructionError:  # too dark a plant
        return {}
    joined = {key: np.concatenate([part[key] for part in parts if part]) for key in parts[0] or parts[1]}
    return {"names": np.array(HOLE_FEATURES), **joined} if joined else {}


def _as_arrays(samples: Samples) -> dict[str, np.ndarray]:
    """Return features, targets and weights; every capture or surface has the same mean weight."""
    if not len(samples.y):
        return {}
    weight = samples.scale_mm * (len(samples.y) / samples.scale_mm.sum())
    return {"x": samples.x, "y": samples.y.astype(np.float32), "weight": weight.astype(np.float32)}
