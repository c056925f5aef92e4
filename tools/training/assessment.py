"""Metrics of the networks, and of the reconstruction with them, on scenarios that were held out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from scipy.stats import rankdata

from beltscape.core.statistics import MAD_TO_SIGMA
from beltscape.evaluate.depth_scores import GROSS_MM, interior_mask, score_depth
from beltscape.evaluate.frame_scores import compute_sigma_ratios
from beltscape.learned.registry import load_network
from training.cache import SampleCache
from training.confidence import collect_candidates, collect_pixels, mask_measured, mask_right
from training.holes import MAX_TARGET, collect_holes
from training.lumps import collect_lumps
from training.reconstructions import reconstruct_capture
from training.samples.augmentation import read_simulated
from training.samples.pixels import ALONG_MM, mask_scene

Metrics = dict[str, float]


def assess_networks(
    captures: list[Path], heaps: list[Path], cache: SampleCache, names: Sequence[str] = ()
) -> dict[str, Metrics]:
    """Return the metrics of each network that can be judged by itself, by name; of some where these are named.

    ``heaps`` are the captures of moving heaps.
    """
    pixels = ("initial_confidence", "confidence", "fast_confidence")
    recipes: dict[str, Callable[[], Metrics]] = {
        **{name: partial(_assess_pixels, name, captures, cache) for name in pixels},
        "candidates": partial(_assess_candidates, captures, cache),
        "holes": partial(_assess_holes, captures, heaps, cache),
        "lumps": partial(_assess_lumps, captures, cache),
    }
    return {name: assess() for name, assess in recipes.items() if not names or name in names}


def assess_reconstruction(captures: list[Path], preset: str) -> Metrics:
    """Return the mean scores of a preset over the captures whose surface is found."""
    found: list[Metrics] = []
    for folder in captures:
        depth, capture = reconstruct_capture(folder, preset), read_simulated(folder)
        if depth is None:
            continue
        truth = capture.depth_mm.astype(float)
        near = np.abs(capture.rig.core_camera.rays()[..., 1] * truth) <= ALONG_MM
        scene = mask_scene(capture.label) & near
        score = score_depth(depth, truth, scene)
        error = depth.depth_mm - truth
        counted = scene & interior_mask(truth) & (np.abs(np.nan_to_num(error, nan=np.inf)) < GROSS_MM)
        ratios = compute_sigma_ratios(error[counted], depth.sigma_mm[counted])
        found.append(
            {
                "within 1 mm": score.within_1mm,
                "within 0.25 mm": score.within_quarter_mm,
                "gross": score.gross,
                "least sigma ratio": float(ratios.min()),
                "greatest sigma ratio": float(ratios.max()),
            }
        )
    return {what: float(np.mean([one[what] for one in found])) for what in found[0]}


def compute_auc(score: np.ndarray, right: np.ndarray) -> float:
    """Return the area under the ROC curve: the share of pairs of a right and a wrong one that are ordered right.

    Hanley & McNeil 1982, doi:10.1148/radiology.143.1.7063747; NaN where all are right or all are wrong.
    """
    positive = int(right.sum())
    negative = right.size - positive
    if not positive or not negative:
        return np.nan
    return float((rankdata(score)[right].sum() - positive * (positive + 1) / 2) / (positive * negative))


def _evaluate(name: str, samples: dict[str, np.ndarray], features: str) -> np.ndarray:
    """Return the outputs (m, N) of a network for samples."""
    columns = dict(zip(map(str, samples["names"]), samples[features].T, strict=True))
    return load_network(name).evaluate_values(columns)


def _assess_pixels(name: str, captures: list[Path], cache: SampleCache) -> Metrics:
    samples = collect_pixels(name, captures, cache)
    logit, *log_sigma = _evaluate(name, samples, "features")
    metrics = {"area under the ROC curve": compute_auc(logit, mask_right(samples))}
    if log_sigma:
        used = mask_measured(samples, logit) & samples["interior"]
        scaled = np.abs(samples["centred_px"][used]) / np.exp(log_sigma[0][used])
        metrics["sigma ratio"] = float(MAD_TO_SIGMA * np.median(scaled))
    return metrics


def _assess_candidates(captures: list[Path], cache: SampleCache) -> Metrics:
    samples = collect_candidates(captures, cache)
    (logit,) = _evaluate("candidates", samples, "features")
    return {"area under the ROC curve": compute_auc(logit, samples["right"][:, 0])}


def _assess_holes(captures: list[Path], heaps: list[Path], cache: SampleCache) -> Metrics:
    samples = collect_holes(captures, heaps, cache)
    mean, sigma = load_network("holes").predict_mean_and_sigma(
        dict(zip(map(str, samples["names"]), samples["x"].T, strict=True))
    )
    target = np.clip(samples["y"], -MAX_TARGET, MAX_TARGET)
    error, weight = mean - target, samples["weight"]
    spread = np.average(target**2, weights=weight)
    return {
        "mean error over target, RMS": float(np.average(error, weights=weight) / np.sqrt(spread)),
        "error over target, RMS": float(np.sqrt(np.average(error**2, weights=weight) / spread)),
        "sigma ratio": float(np.sqrt(np.average((error / sigma) ** 2, weights=weight))),
    }


def _assess_lumps(captures: list[Path], cache: SampleCache) -> Metrics:
    samples = collect_lumps(captures, cache)
    outputs = _evaluate("lumps", samples, "features")
    return {
        f"area under the ROC curve, {what}": compute_auc(logit, right)
        for what, logit, right in zip(("outline", "lump"), outputs, samples["target"].T, strict=True)
    }
