"""Lumps against a simulated heap whose rocks are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError
from beltscape.evaluate.scores.depth import robust_sigma
from beltscape.measure.lumps.distribution import compute_passing_sizes
from beltscape.measure.lumps.lumps import FINES, Lumps

FULL_SHARE = 0.25
"""A rock counts as visible when it shows this share of a disc of its size."""
MEASURED_SHARE = 0.8
"""Of a rock's pixels: with less of its depth its outline cannot be right."""
LEAST_PX = 100
"""Smaller areas of the depth map are slivers, not rocks to be found."""
_MATCH = 0.5
"""Intersection over union from which on two outlines are one."""


@dataclass(frozen=True, slots=True)
class LumpScore:
    """How found lumps compare with the rocks in view; sizes in mm, NaN where there is nothing to count.

    A rock is visible when it shows `LEAST_PX` pixels and `FULL_SHARE` of a disc of its size. A lump and a rock
    match when intersection over union of their pixels is above one half, so none matches twice.
    """

    rocks: int
    """Visible rocks as large as the smallest size."""
    recall: float
    """Share of them that a lump matches."""
    rocks_measured: int
    """Visible rocks of which at least `MEASURED_SHARE` was measured; all where that is not told."""
    recall_measured: float
    """Share of them that a lump matches."""
    precision: float
    """Share of the lumps as large as the smallest size that match a rock."""
    iou: float
    """Best IoU of each visible rock, weighted by area."""
    rocks_over: int
    """Visible rocks over the limit."""
    recall_over: float
    """Share of them that a lump matches."""
    lumps_over: int
    """Lumps measured over the limit, the frame's cut ones too."""
    precision_over: float
    """Share of them that match a rock."""
    alarm_recall: float
    """Share of the rocks over the limit whose lump is measured over it, too."""
    alarm_precision: float
    """Share of the lumps over the limit whose rock is over it, too."""
    sized: int
    """Matched lumps that are neither cut by the frame nor hidden by others, of rocks above the smallest size."""
    size_bias: float
    """Median of measured over true size, less one."""
    size_error: float
    """Median of its absolute value."""
    size_iqr: float
    """Between its quartiles."""
    sigma_ratio: float
    """Robust scatter of the error in units of the σ claimed."""
    all_sized: int
    """Matched lumps whether hidden or not, but not cut by the frame."""
    all_bias: float
    """Median of their measured over true size, less one."""
    all_error: float
    """Median of its absolute value."""
    d50_mm: float
    """Measured by estimated mass."""
    d50_top_mm: float
    """Of the rocks that show `LEAST_PX` pixels, by their true mass: what a perfect eye would say."""
    d50_heap_mm: float
    """Of all rocks of the heap by mass: the top layer's own bias lies between."""


@dataclass(frozen=True, slots=True, eq=False)
class Overlap:
    """How lumps' and rocks' pixels share a picture; only pixels on both are paired."""

    lump: NDArray[np.int64]
    """(P,) a lump's number, from 1."""
    rock: NDArray[np.int64]
    """(P,) a rock's number, from 0."""
    iou: NDArray[np.float64]
    """(P,) intersection over union of the two."""


def overlap(labels: NDArray[np.integer], rock: NDArray[np.integer], lumps: int, rocks: int) -> Overlap:
    """Of a label picture (H, W) of so many lumps, and the true one (H, W)."""
    number = np.where(labels <= lumps, labels, 0).ravel().astype(np.int64)
    truth = rock.ravel().astype(np.int64) + 1
    pair, shared = np.unique(number * (rocks + 1) + truth, return_counts=True)
    a, b = pair // (rocks + 1), pair % (rocks + 1)
    both = (a > 0) & (b > 0)
    whole = np.bincount(number, minlength=lumps + 1)[a] + np.bincount(truth, minlength=rocks + 1)[b] - shared
    return Overlap(a[both], b[both] - 1, (shared / whole)[both])


def score_lumps(
    found: Lumps,
    rock: NDArray[np.integer],
    size_mm: NDArray[np.float64],
    volume_mm3: NDArray[np.float64],
    *,
    pixel_mm: float,
    over_mm: float = 60.0,
    smallest_mm: float = 15.0,
    region: NDArray[np.bool_] | None = None,
    measured: NDArray[np.bool_] | None = None,
) -> LumpScore:
    """Compare lumps with the truth.

    Parameters
    ----------
    found
        What was measured.
    rock
        (H, W) number of the rock that each pixel of the core's grid truly shows, -1: none.
    size_mm, volume_mm3
        (N,) of the rocks.
    pixel_mm
        Width of a pixel on the load.
    over_mm
        The limit of what counts as large.
    smallest_mm
        Rocks and lumps below are left out.
    region
        (H, W) bool: where to compare, such as what a matcher could reach at all; everywhere by default.
    measured
        (H, W) bool: where there was a depth to find lumps in; everywhere by default.

    Raises
    ------
    InputError
        When the shapes differ.
    """
    if found.labels.shape != rock.shape:
        raise InputError(f"the truth is {rock.shape}, the label picture {found.labels.shape} pixels")
    shown = rock if region is None else np.where(region, rock, -1)
    labels = found.labels if region is None else np.where(region, found.labels, 0)
    count = len(found.lumps)
    shared = overlap(labels, shown, count, len(size_mm))
    match = shared.iou > _MATCH
    rock_of = np.full(count + 1, -1)
    rock_of[shared.lump[match]] = shared.rock[match]
    matched = np.zeros(len(size_mm), bool)
    matched[shared.rock[match]] = True
    best = np.zeros(len(size_mm))
    np.maximum.at(best, shared.rock, shared.iou)
    area = np.bincount(shown[shown >= 0].ravel(), minlength=len(size_mm))
    disc = np.pi / 4 * (size_mm / pixel_mm) ** 2
    visible = (area >= LEAST_PX) & (area >= FULL_SHARE * disc) & (size_mm >= smallest_mm)
    large = visible & (size_mm > over_mm)
    there = shown >= 0 if measured is None else (shown >= 0) & measured
    clear = visible & (
        np.bincount(shown[there].ravel(), minlength=len(size_mm)) >= MEASURED_SHARE * np.maximum(area, 1)
    )
    seen_at_all = (area >= LEAST_PX) & (size_mm >= found.smallest_mm)
    seen = np.bincount(labels.ravel(), minlength=FINES + 1)[1 : count + 1] > 0
    sizes = np.array([lump.size_mm for lump in found.lumps])
    sigma = np.array([lump.sigma_mm for lump in found.lumps])
    own = rock_of[1:]
    true = np.where(own >= 0, size_mm[own], np.nan)
    hit = (own >= 0) & seen
    big = seen & (sizes > over_mm)
    alarmed = np.zeros(len(size_mm), bool)
    alarmed[own[hit & big]] = True
    entire = hit & ~np.array([lump.cut for lump in found.lumps], bool) & (true >= smallest_mm)
    free = entire & ~np.array([lump.occluded for lump in found.lumps], bool)
    error = sizes / true - 1
    return LumpScore(
        rocks=int(visible.sum()),
        recall=_mean(matched[visible]),
        rocks_measured=int(clear.sum()),
        recall_measured=_mean(matched[clear]),
        precision=_mean(hit[seen & (sizes >= smallest_mm)]),
        iou=float((best * area)[visible].sum() / area[visible].sum()) if visible.any() else np.nan,
        rocks_over=int(large.sum()),
        recall_over=_mean(matched[large]),
        lumps_over=int(big.sum()),
        precision_over=_mean(hit[big]),
        alarm_recall=_mean(alarmed[large]),
        alarm_precision=_mean((true > over_mm)[big]),
        sized=int(free.sum()),
        size_bias=_median(error[free]),
        size_error=_median(np.abs(error[free])),
        size_iqr=float(np.subtract(*np.quantile(error[free], [0.75, 0.25]))) if free.any() else np.nan,
        sigma_ratio=robust_sigma(((sizes - true) / sigma)[free]),
        all_sized=int(entire.sum()),
        all_bias=_median(error[entire]),
        all_error=_median(np.abs(error[entire])),
        d50_mm=found.all.d_mm[1],
        d50_top_mm=_d50(size_mm[seen_at_all], volume_mm3[seen_at_all]),
        d50_heap_mm=_d50(size_mm, volume_mm3),
    )


def _d50(size_mm: NDArray[np.float64], volume_mm3: NDArray[np.float64]) -> float:
    return float(compute_passing_sizes(size_mm, volume_mm3, (0.5,))[0]) if len(size_mm) else np.nan


def _mean(values: NDArray[np.bool_]) -> float:
    return float(values.mean()) if values.size else np.nan


def _median(values: NDArray[np.float64]) -> float:
    return float(np.median(values)) if values.size else np.nan
