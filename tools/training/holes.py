"""Recipes of the networks that fill holes and correct edge fattening."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from beltscape.learned.network import LOG_VARIANCE, Network
from training.cache import SampleCache
from training.losses import make_mean_and_variance
from training.perceptron import Schedule, average_networks, compute_limits, fit_perceptron
from training.reconstructions import reconstruct_capture
from training.samples.holes import Samples, draw_hole_samples, simulate_smooth_samples

SCHEDULES = {
    "holes": Schedule((16, 8), epochs=6, batch=1024, decay=1e-5),
    "edge_fattening": Schedule((12,), epochs=8, batch=512, decay=1e-4),
}
MAX_TARGET = {"holes": 5.0, "edge_fattening": 1.2}
"""Absolute value to which targets are clipped."""
VARIANCE_WEIGHT = 0.1
"""Weight of the likelihood of the variance, relative to the squared error of the mean."""
MEMBERS = 3
"""Size of the ensemble: networks from different initial weights, whose outputs are averaged."""
SMOOTH_SURFACES = 160
"""Number of simulated smooth surfaces and piles, which keep the prediction of such holes unbiased."""


def collect_cells(name: str, captures: list[Path], cache: SampleCache) -> dict[str, np.ndarray]:
    """Return the samples of cells for a network."""
    return cache.collect(name, captures, lambda capture, _: _draw(name, capture))


def train_measuring(name: str, captures: list[Path], cache: SampleCache) -> Network:
    """Train ``holes`` or ``edge_fattening``: the mean by least squares, the spread by the residuals' likelihood."""
    samples = collect_cells(name, captures, cache)
    names = tuple(map(str, samples.pop("names")))
    parts = [samples, *(_as_arrays(_draw_smooth(seed, name)) for seed in range(SMOOTH_SURFACES))]
    x, y, weight = (np.concatenate([part[key] for part in parts if part]) for key in ("x", "y", "weight"))
    y = np.clip(y, -MAX_TARGET[name], MAX_TARGET[name])
    loss = make_mean_and_variance(y, weight / weight.mean(), VARIANCE_WEIGHT, LOG_VARIANCE)
    limits = compute_limits(x)
    outputs = ("mean", "log variance")
    members = [
        fit_perceptron(names, outputs, x, loss, SCHEDULES[name], limits=limits, seed=seed)
        for seed in range(MEMBERS)
    ]
    return average_networks(members)


def _draw(name: str, capture: Path) -> dict[str, np.ndarray]:
    if not next((capture / "truth").glob("*_load.npz"), None):
        return {}
    depth = reconstruct_capture(capture)
    if depth is None:
        return {}
    samples = draw_hole_samples(capture, depth)[name]
    arrays = _as_arrays(samples)
    return {"names": np.array(samples.names), **arrays} if arrays else {}


def _draw_smooth(seed: int, name: str) -> Samples:
    return simulate_smooth_samples(np.random.default_rng(seed))[name]


def _as_arrays(samples: Samples) -> dict[str, np.ndarray]:
    """Return features, targets and weights; every capture or surface has the same mean weight."""
    if not len(samples.y):
        return {}
    weight = samples.scale_mm * (len(samples.y) / samples.scale_mm.sum())
    return {"x": samples.x, "y": samples.y.astype(np.float32), "weight": weight.astype(np.float32)}
