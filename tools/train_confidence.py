"""Train the networks of confidence, sigma and candidate selection on simulated captures with truth.

    python tools/train_confidence.py NETWORK CAPTURE… [--out FOLDER]

NETWORK is initial_confidence, candidates, pairwise_ranking, confidence, sigma or fast_confidence. Each CAPTURE is
what ``beltscape simulate SCENE --out CAPTURE`` wrote: loaded belts, modules and empty belts, with and without
speckle, of several rigs, image sizes and seeds, with rough stones and with even ones. Every capture is matched as
it is and with augmentations (tools/augmentation.py); one named twice counts twice, with other augmentations. The
first four depend on each other in this order, and train_refinement.py on them. ``sigma`` trains only the sigma of
``confidence`` again; ``fast_confidence`` is for the preset ``fast``. Each is written to a file of its name in
FOLDER, without it to data/, from where the program reads it. Assess the result on captures that are not among them.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

import beltscape
from adam import Gradient, Schedule, fit_layers
from beltscape.core.statistics import MAD_TO_SIGMA
from beltscape.stereo.multiview.networks import load_network
from pixel_samples import Sample, pixel_samples, selection_samples

DATA = Path(beltscape.__file__).parent / "data"
"""Folder from which the program reads the networks."""
GROSS_MM = 4.0
"""Error from which on a surface is false."""
RIGHT_PX = 1.25
"""Error up to which a candidate is right, at scale 1."""
NEAR = 0.1
"""Weight of a pixel near a true step in the fit of sigma."""
LIMIT = 4.0
"""Features are clipped to this many standard deviations around their mean."""
ACCEPTED = 0.75
"""Sigma is fitted to pixels of at least this confidence ..."""
MOST_MM = 5.0
"""... and at most this error; false surfaces are left to the confidence."""
ROUND = 0.1
"""Half width of the parabola that rounds the corner of the absolute deviation."""


class Plan(NamedTuple):
    """Parameters of a network's training."""

    hidden: tuple[int, ...]
    epochs: int = 16
    batch: int = 8192
    occluded: float = 4.0
    """Weight of a pixel that no auxiliary sees: they are few, and right there only by chance."""


PLANS = {
    "initial_confidence": Plan((32,)),
    "candidates": Plan((32,)),
    "pairwise_ranking": Plan((64, 32), epochs=32, batch=4096),
    "confidence": Plan((32,)),
    "fast_confidence": Plan((64,)),
    "sigma": Plan((32,)),
}
RATE = 4e-3

Layers = list[np.ndarray]
"""(outputs, inputs + 1) weights and offsets of each layer, as in the files."""


class TrainedNetwork(NamedTuple):
    """A trained network."""

    name: str
    features: tuple[str, ...]
    limits: np.ndarray
    """(2, n) limits to which the features are clipped."""
    layers: Layers


def train_candidates(folders: list[Path]) -> TrainedNetwork:
    """Train the logit of the probability that a candidate is right."""
    features, right = [], []
    names: tuple[str, ...] = ()
    for frame in selection_samples(folders):
        for _, candidates, values, ds in frame.draw():
            finite = np.isfinite(candidates.s)
            features.append(np.stack([plane[finite] for plane in values.values()], -1).astype(np.float32))
            right.append(np.abs(ds[finite]) <= RIGHT_PX)
            names = tuple(values)
    return train_logits("candidates", names, np.concatenate(features), np.concatenate(right)[:, None])


def train_pairwise_ranking(folders: list[Path]) -> TrainedNetwork:
    """Train the logits of the probabilities that the top two candidates are right."""
    features, right = [], []
    names: tuple[str, ...] = ()
    for frame in selection_samples(folders):
        for at, candidates, values, ds in frame.draw():
            first, second, score = frame.selector.rank_top_two(candidates, values)
            paired = np.flatnonzero(second >= 0)
            pair = first[paired], second[paired]
            pairs = frame.selector.compute_pairwise_features(
                at, candidates, {**values, "score": score}, paired, pair
            )
            features.append(np.concatenate(list(pairs.values())).T.astype(np.float32))
            right.append(np.stack([np.abs(ds[index, paired]) <= RIGHT_PX for index in pair], -1))
            names = tuple(pairs)
    return train_logits("pairwise_ranking", names, np.concatenate(features), np.concatenate(right))


def train_logits(network: str, names: tuple[str, ...], x: np.ndarray, right: np.ndarray) -> TrainedNetwork:
    """Train a network for the logits of ``right`` (n, m) from features (n, names)."""
    limits, right = compute_limits(x), right.astype(np.float32)
    gradient = cross_entropy_gradient(right, np.ones_like(right))
    layers = fit_clipped(x, limits, gradient, right.shape[1], PLANS[network])
    return TrainedNetwork(network, names, limits, layers)


def cross_entropy_gradient(right: np.ndarray, weight: np.ndarray) -> Gradient:
    """Return the gradient of the cross-entropy: the outputs (n, m) become the logits of the share that is right."""
    return lambda out, at: (weight[at] * (1 / (1 + np.exp(-out)) - right[at]) / np.float32(len(at))).astype(
        np.float32
    )


def deviation_gradient(log_size: np.ndarray, weight: np.ndarray) -> Gradient:
    """Return the gradient of the absolute deviation: the output becomes the median of the logarithm."""
    return lambda out, at: (
        weight[at, None] * np.clip((out - log_size[at, None]) / ROUND, -1, 1) / np.float32(len(at))
    ).astype(np.float32)


def compute_limits(x: np.ndarray) -> np.ndarray:
    """Return the (2, n) limits to which features (N, n) are clipped."""
    mean, spread = np.nanmean(x, axis=0, dtype=float), np.nanstd(x, axis=0, dtype=float)
    low, high = mean - LIMIT * spread, mean + LIMIT * spread
    limits = np.stack([np.maximum(low, np.nanmin(x, axis=0)), np.minimum(high, np.nanmax(x, axis=0))])
    return limits.astype(np.float32)


def fit_clipped(
    x: np.ndarray,
    limits: np.ndarray,
    gradient: Gradient,
    outputs: int,
    plan: Plan,
    start: float = 0.0,
) -> Layers:
    """Return the layers of least loss for features clipped to their limits."""
    within = np.where(np.isnan(x), limits[0], x)
    np.clip(within, *limits, out=within)
    mean, spread = within.mean(axis=0, dtype=float), within.std(axis=0, dtype=float) + 1e-6
    within -= mean.astype(np.float32)
    within /= spread.astype(np.float32)
    schedule = Schedule(plan.hidden, plan.epochs, plan.batch, RATE, 1e-6, 0.3)

    def shifted_gradient(out: np.ndarray, at: np.ndarray) -> np.ndarray:
        return gradient(out + np.float32(start), at)

    (weights, offset), *others = fit_layers(
        within, outputs, shifted_gradient, schedule, np.random.default_rng(0)
    )
    first = np.hstack([weights.T / spread, (offset - (mean / spread) @ weights)[:, None]])
    layers = [first, *(np.hstack([weights.T, offset[:, None]]) for weights, offset in others)]
    layers[-1][:, -1] += start
    return [layer.astype(float) for layer in layers]


def evaluate(x: np.ndarray, limits: np.ndarray, layers: Layers) -> np.ndarray:
    """Return the (n,) outputs of a network with one output."""
    found = np.clip(np.where(np.isnan(x), limits[0], x), *limits)
    for layer in layers[:-1]:
        found = np.maximum(found @ layer[:, :-1].T + layer[:, -1], 0)
    return found @ layers[-1][0, :-1] + layers[-1][0, -1]


def centre_errors(sample: Sample) -> np.ndarray:
    """Return the (n,) errors in px around their median; sigma is their spread."""
    counted = sample.interior & (np.abs(sample.dz_mm) <= MOST_MM)
    return sample.ds_px - np.median(sample.ds_px[counted]) if counted.any() else sample.ds_px


def train_pixels(samples: list[Sample], network: str) -> TrainedNetwork:
    """Train the logit of a pixel's confidence and, except for the initial one, the logarithm of its sigma."""
    names = samples[0].names
    x = np.concatenate([sample.features for sample in samples])
    dz = np.abs(np.concatenate([sample.dz_mm for sample in samples]))
    limits = compute_limits(x)
    occluded = np.concatenate([s.occluded for s in samples])
    right = ((dz <= GROSS_MM) & ~occluded).astype(np.float32)
    weight = np.where(occluded, PLANS[network].occluded, 1).astype(np.float32)
    confidence = fit_clipped(
        x, limits, cross_entropy_gradient(right[:, None], weight[:, None]), 1, PLANS[network]
    )
    if network == "initial_confidence":
        return TrainedNetwork(network, names, limits, confidence)
    layers = merge_networks(confidence, train_sigma(samples, x, limits, confidence))
    return TrainedNetwork(network, names, limits, layers)


def retrain_sigma(samples: list[Sample]) -> TrainedNetwork:
    """Train only the sigma of ``confidence`` again; the logit stays as it is, also with additional features."""
    names, shipped = samples[0].names, load_network("confidence")
    x = np.concatenate([sample.features for sample in samples])
    columns = [names.index(name) for name in shipped.names]
    limits = compute_limits(x)
    limits[:, columns] = shipped.limits
    (units, output), own = shipped.layers, PLANS["confidence"].hidden[0]
    first = np.zeros((own, len(names) + 1))
    first[:, [*columns, -1]] = units[:own]
    confidence = [first, np.hstack([output[:1, :own], output[:1, -1:]]).astype(float)]
    layers = merge_networks(confidence, train_sigma(samples, x, limits, confidence))
    return TrainedNetwork("confidence", names, limits, layers)


def train_sigma(samples: list[Sample], x: np.ndarray, limits: np.ndarray, confidence: Layers) -> Layers:
    """Return layers for the logarithm of sigma, px, fitted to accepted pixels that are not false."""
    dz, ds = (
        np.abs(np.concatenate(part)) for part in ([s.dz_mm for s in samples], [*map(centre_errors, samples)])
    )
    used = (dz <= MOST_MM) & (evaluate(x, limits, confidence) > np.log(ACCEPTED / (1 - ACCEPTED)))
    sizes = np.log(MAD_TO_SIGMA * np.maximum(ds[used], 1e-6)).astype(np.float32)
    weight = np.where(np.concatenate([s.interior for s in samples])[used], 1, NEAR).astype(np.float32)
    size = samples[0].names.index("log grid scale")  # with it, sigma would fit single captures of that size
    units, output = fit_clipped(
        np.delete(x[used], size, axis=1), np.delete(limits, size, axis=1), deviation_gradient(sizes, weight),
        1, PLANS["sigma"], float(np.median(sizes)),
    )  # fmt: skip
    return [np.insert(units, size, 0, axis=1), output]


def merge_networks(*networks: Layers) -> Layers:
    """Return networks with one hidden layer each as one network with all their outputs."""
    hidden, outputs = zip(*networks, strict=True)
    constants = np.concatenate([output[:, -1:] for output in outputs])
    output = np.hstack([block_diag(*(output[:, :-1] for output in outputs)), constants])
    return [np.concatenate(hidden), output]


def write_network(network: TrainedNetwork, folder: Path) -> None:
    """Write a network to a file of its name, one row a line."""
    parts = {
        "names": table(network.features),
        "limits": format_rows(network.limits),
        "layers": f"[{', '.join(map(format_rows, network.layers))}]",
    }
    text = "{" + ",\n".join(f'"{name}": {text}' for name, text in parts.items()) + "}\n"
    (folder / f"{network.name}.json").write_text(text, "utf-8")


def format_rows(rows: np.ndarray) -> str:
    """Return JSON with six digits."""
    return table([[float(f"{value:.6g}") for value in row] for row in rows])


def table(rows: Sequence[object]) -> str:
    """Return JSON, one row a line."""
    return "[\n" + ",\n".join(map(json.dumps, rows)) + "\n]"


def train(network: str, folders: list[Path]) -> TrainedNetwork:
    """Match the captures and train a network."""
    if network == "candidates":
        return train_candidates(folders)
    if network == "pairwise_ranking":
        return train_pairwise_ranking(folders)
    if network == "sigma":
        return retrain_sigma(list(pixel_samples(folders, "confidence")))
    return train_pixels(list(pixel_samples(folders, network)), network)


def main() -> None:
    """Train a network and write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("network", choices=PLANS)
    parser.add_argument("captures", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, default=DATA)
    arguments = parser.parse_args()
    write_network(train(arguments.network, arguments.captures), arguments.out)


if __name__ == "__main__":
    main()
