"""Recipes of the networks of confidence, sigma and candidate selection."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from beltscape.core.statistics import MAD_TO_SIGMA
from beltscape.learned.network import Network
from training.cache import SampleCache
from training.losses import make_absolute_deviation, make_cross_entropy
from training.perceptron import Schedule, fit_perceptron, join_outputs
from training.samples.pixels import Sample, draw_pixel_samples, draw_selection_samples

GROSS_MM = 4.0
"""Error from which on a surface is false."""
RIGHT_PX = 1.25
"""Error up to which a candidate is right, at scale 1."""
NEAR = 0.1
"""Weight of a pixel near a true step in the fit of sigma."""
ACCEPTED = 0.75
"""Sigma is fitted to pixels of at least this confidence ..."""
MOST_MM = 5.0
"""... and at most this error; false surfaces are left to the confidence."""
ROUND = 0.1
"""Half width of the parabola that rounds the corner of the absolute deviation."""
HIDDEN = 4.0
"""Weight of a pixel that no auxiliary sees, and of a wrong one that the projector does not light: they are few, and
a depth there is invented."""
SCHEDULES = {
    "initial_confidence": Schedule((32,), 16, 8192, 4e-3),
    "candidates": Schedule((32,), 16, 8192, 4e-3),
    "confidence": Schedule((32,), 16, 8192, 4e-3),
    "fast_confidence": Schedule((64,), 16, 8192, 4e-3),
    "sigma": Schedule((32,), 16, 8192, 4e-3),
}


def collect_pixels(name: str, captures: list[Path], cache: SampleCache) -> dict[str, np.ndarray]:
    """Return the samples of pixels for a network."""
    return cache.collect(name, captures, partial(_draw_pixels, name))


def _draw_pixels(name: str, folder: Path, turn: int) -> dict[str, np.ndarray]:
    return _stack(list(draw_pixel_samples(folder, turn, name)))


def collect_candidates(captures: list[Path], cache: SampleCache) -> dict[str, np.ndarray]:
    """Return the samples of candidate surfaces."""
    return cache.collect("candidates", captures, _draw_candidates)


def mask_right(samples: dict[str, np.ndarray]) -> np.ndarray:
    """Return the mask (N,) of pixels whose surface is right and seen by an auxiliary."""
    return (np.abs(samples["dz_mm"]) <= GROSS_MM) & ~samples["occluded"]


def train_pixels(name: str, captures: list[Path], cache: SampleCache) -> Network:
    """Train the logit of a pixel's confidence and, except for the initial one, the logarithm of its sigma."""
    samples = collect_pixels(name, captures, cache)
    features = tuple(map(str, samples["names"]))
    x, right = samples["features"], mask_right(samples)[:, None]
    hidden = samples["occluded"] | (samples["dark"] & ~right[:, 0])
    weight = np.where(hidden, HIDDEN, 1)[:, None]
    confidence = fit_perceptron(features, ("logit",), x, make_cross_entropy(right, weight), SCHEDULES[name])
    if name == "initial_confidence":
        return confidence
    return join_outputs(confidence, _train_sigma(samples, confidence))


def _train_sigma(samples: dict[str, np.ndarray], confidence: Network) -> Network:
    """Train the logarithm of sigma, px, on accepted pixels that are not false."""
    x, features = samples["features"], confidence.features
    logit = confidence.evaluate_values(dict(zip(features, x.T, strict=True)))[0]
    used = mask_measured(samples, logit)
    sizes = np.log(MAD_TO_SIGMA * np.maximum(np.abs(samples["centred_px"][used]), 1e-6))
    weight = np.where(samples["interior"][used], 1, NEAR)
    loss = make_absolute_deviation(sizes, weight, ROUND)
    return fit_perceptron(
        features, ("log sigma",), x[used], loss, SCHEDULES["sigma"],
        limits=confidence.limits, start=float(np.median(sizes)),
    )  # fmt: skip


def mask_measured(samples: dict[str, np.ndarray], logit: np.ndarray) -> np.ndarray:
    """Return the mask (N,) of accepted pixels that are not false, whose errors sigma describes."""
    return (np.abs(samples["dz_mm"]) <= MOST_MM) & (logit > np.log(ACCEPTED / (1 - ACCEPTED)))


def train_candidates(captures: list[Path], cache: SampleCache) -> Network:
    """Train the logit of the probability that a candidate is right."""
    samples = collect_candidates(captures, cache)
    loss = make_cross_entropy(samples["right"])
    names = tuple(map(str, samples["names"]))
    return fit_perceptron(names, ("logit",), samples["features"], loss, SCHEDULES["candidates"])


def _draw_candidates(folder: Path, turn: int) -> dict[str, np.ndarray]:
    names: tuple[str, ...] = ()
    drawn: list[tuple[np.ndarray, np.ndarray]] = []
    for frame in draw_selection_samples(folder, turn):
        for _, candidates, values, ds in frame.draw():
            names, finite = tuple(values), np.isfinite(candidates.s)
            features = np.concatenate(list(values.values())).T.astype(np.float32)
            drawn.append((features, (np.abs(ds[finite]) <= RIGHT_PX)[:, None]))
    if not drawn:
        return {}
    features, right = (np.concatenate(part) for part in zip(*drawn, strict=True))
    return {"names": np.array(names), "features": features, "right": right}


def _stack(samples: list[Sample]) -> dict[str, np.ndarray]:
    """Return the samples of a capture's training frames as arrays over their pixels."""
    if not samples:
        return {}
    return {
        "names": np.array(samples[0].names),
        "features": np.concatenate([s.features for s in samples]),
        "dz_mm": np.concatenate([s.dz_mm for s in samples]),
        "centred_px": np.concatenate([_centre_errors(s) for s in samples]),
        "interior": np.concatenate([s.interior for s in samples]),
        "occluded": np.concatenate([s.occluded for s in samples]),
        "dark": np.concatenate([s.dark for s in samples]),
    }


def _centre_errors(sample: Sample) -> np.ndarray:
    """Return the (n,) errors in px around their median; sigma is their spread."""
    counted = sample.interior & (np.abs(sample.dz_mm) <= MOST_MM)
    return sample.ds_px - np.median(sample.ds_px[counted]) if counted.any() else sample.ds_px
