"""Scores of measured lumps against the known rocks of a simulated heap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera
from beltscape.evaluate.depth_scores import compute_robust_sigma
from beltscape.files.arrays import read_arrays
from beltscape.files.json_text import read_json
from beltscape.files.reconstruction import read_frame
from beltscape.files.rig_json import read_rig
from beltscape.measure.lumps.lumps import FINES, SHARES, Lumps, compute_passing_sizes, measure_lumps
from beltscape.measure.lumps.settings import LumpSettings

FULL_SHARE = 0.25
"""Least share of a disc of its size that a visible rock shows; with less its outline does not show its size."""
MEASURED_SHARE = 0.8
"""Share of a rock's pixels with a depth from which its outline can be measured."""
LEAST_PX = 100
"""Smallest visible area of a rock that can be detected: 10 × 10 px; smaller ones are slivers."""
_MATCH = 0.5
"""Intersection over union above which two outlines match; at 0.5 a match is unique (as in PASCAL VOC)."""


@dataclass(frozen=True, slots=True)
class LumpScore:
    """Scores of measured lumps against the visible rocks; sizes in mm, NaN for an empty set.

    A rock is visible if it shows `LEAST_PX` pixels and `FULL_SHARE` of a disc of its size. A lump and a rock
    match if the intersection over union of their pixels is above one half, so none matches twice.
    """

    rocks: int
    """Visible rocks as large as the smallest size."""
    recall: float
    """Share of them that a lump matches."""
    rocks_measured: int
    """Visible rocks of which at least `MEASURED_SHARE` was measured; all if that is not known."""
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
    """Lumps measured over the limit, including those cut by the frame."""
    precision_over: float
    """Share of them that match a rock."""
    alarm_recall: float
    """Share of the rocks over the limit whose lump is also measured over it."""
    alarm_precision: float
    """Share of the lumps over the limit whose rock is also over it."""
    sized: int
    """Matched lumps that are neither cut by the frame nor hidden by others, of rocks above the smallest size."""
    size_bias: float
    """Median of measured over true size, less one."""
    size_error: float
    """Median of its absolute value."""
    size_iqr: float
    """Between its quartiles."""
    sigma_ratio: float
    """Robust scatter of the error in units of the predicted σ."""
    all_sized: int
    """Matched lumps whether hidden or not, but not cut by the frame."""
    all_bias: float
    """Median of their measured over true size, less one."""
    all_error: float
    """Median of its absolute value."""
    d50_mm: float
    """Measured by estimated mass."""
    d50_top_mm: float
    """Distribution of the rocks that show `LEAST_PX` pixels, by true mass: a perfect measurement's result."""
    d_mm: tuple[float, ...]
    """d10, d50, d80, d90 measured by estimated mass."""
    d_sigma_mm: tuple[float, ...]
    """One standard deviation each."""
    d_top_mm: tuple[float, ...]
    """The same of the rocks that show `LEAST_PX` pixels, by true mass."""
    d50_heap_mm: float
    """Distribution of all rocks of the heap by mass; the difference is the bias of the top layer."""


@dataclass(frozen=True, slots=True, eq=False)
class LabelOverlap:
    """Overlap of the lumps and rocks of a label picture, for all pairs with common pixels."""

    lump: NDArray[np.int64]
    """(P,) a lump's number, from 1."""
    rock: NDArray[np.int64]
    """(P,) a rock's number, from 0."""
    iou: NDArray[np.float64]
    """(P,) intersection over union of the two."""


def compute_overlap(
    labels: NDArray[np.integer], rock: NDArray[np.integer], lumps: int, rocks: int
) -> LabelOverlap:
    """Return the overlap of a label picture (H, W) and the true one (H, W), with their numbers of labels."""
    number = np.where(labels <= lumps, labels, 0).ravel().astype(np.int64)
    truth = rock.ravel().astype(np.int64) + 1
    pair, shared = np.unique(number * (rocks + 1) + truth, return_counts=True)
    a, b = pair // (rocks + 1), pair % (rocks + 1)
    both = (a > 0) & (b > 0)
    whole = np.bincount(number, minlength=lumps + 1)[a] + np.bincount(truth, minlength=rocks + 1)[b] - shared
    return LabelOverlap(a[both], b[both] - 1, (shared / whole)[both])


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

    ``rock`` (H, W) is the number of the rock that each pixel of the core's grid shows, -1: none; ``size_mm`` and
    ``volume_mm3`` (N,) are the rocks'. ``pixel_mm`` is the width of a pixel on the load. Rocks above ``over_mm`` are
    large; rocks and lumps below ``smallest_mm`` are left out. ``region`` and ``measured`` (H, W) bool are the pixels
    to compare and those with a measured depth; all by default.

    Raises
    ------
    InputError
        When the shapes differ.
    """
    if found.labels.shape != rock.shape:
        raise InputError(f"the truth is {rock.shape}, the label picture {found.labels.shape} pixels")
    rock = rock if region is None else np.where(region, rock, -1)
    labels = found.labels if region is None else np.where(region, found.labels, 0)
    rocks = _Rocks.from_picture(rock, size_mm, pixel_mm, smallest_mm, measured)
    shared = compute_overlap(labels, rock, len(found.lumps), len(size_mm))
    lumps = _Lumps.from_overlap(found, labels, shared, size_mm)
    is_matched = np.zeros(len(size_mm), bool)
    is_matched[shared.rock[shared.iou > _MATCH]] = True
    is_entire = lumps.is_matched & ~lumps.is_cut & (lumps.true_mm >= smallest_mm)
    is_free = is_entire & ~lumps.is_occluded
    error = lumps.size_mm / lumps.true_mm - 1
    is_top = (rocks.area_px >= LEAST_PX) & (size_mm >= found.smallest_mm)
    visible, clear = rocks.is_visible, rocks.is_measured
    return LumpScore(
        rocks=int(visible.sum()),
        recall=_mean(is_matched[visible]),
        rocks_measured=int(clear.sum()),
        recall_measured=_mean(is_matched[clear]),
        precision=_mean(lumps.is_matched[lumps.is_shown & (lumps.size_mm >= smallest_mm)]),
        iou=_mean_iou(shared, rocks),
        **_over_score(rocks.is_visible & (size_mm > over_mm), lumps, is_matched, over_mm),
        **_size_score(error, ((lumps.size_mm - lumps.true_mm) / lumps.sigma_mm), is_entire, is_free),
        d50_mm=found.all.d_mm[1],
        d50_top_mm=_d50(size_mm[is_top], volume_mm3[is_top]),
        d_mm=found.all.d_mm,
        d_sigma_mm=found.all.d_sigma_mm,
        d_top_mm=_compute_percentiles(size_mm[is_top], volume_mm3[is_top]),
        d50_heap_mm=_d50(size_mm, volume_mm3),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Rocks:
    """The rocks in view, (N,) each."""

    area_px: NDArray[np.int64]
    is_visible: NDArray[np.bool_]
    is_measured: NDArray[np.bool_]

    @classmethod
    def from_picture(
        cls,
        rock: NDArray[np.integer],
        size_mm: NDArray[np.float64],
        pixel_mm: float,
        smallest_mm: float,
        measured: NDArray[np.bool_] | None,
    ) -> _Rocks:
        """Return which rocks of a picture (H, W) count as visible and as measured."""
        area = np.bincount(rock[rock >= 0].ravel(), minlength=len(size_mm))
        disc = np.pi / 4 * (size_mm / pixel_mm) ** 2
        visible = (area >= LEAST_PX) & (area >= FULL_SHARE * disc) & (size_mm >= smallest_mm)
        has_depth = rock >= 0 if measured is None else (rock >= 0) & measured
        measured_px = np.bincount(rock[has_depth].ravel(), minlength=len(size_mm))
        return cls(area, visible, visible & (measured_px >= MEASURED_SHARE * np.maximum(area, 1)))


@dataclass(frozen=True, slots=True, eq=False)
class _Lumps:
    """The measured lumps with their rocks, (M,) each."""

    size_mm: NDArray[np.float64]
    sigma_mm: NDArray[np.float64]
    rock: NDArray[np.int64]
    """Number of the rock that the lump matches, -1: none."""
    true_mm: NDArray[np.float64]
    """Size of that rock; NaN: none."""
    is_shown: NDArray[np.bool_]
    """Whether any of its pixels lies in the region."""
    is_matched: NDArray[np.bool_]
    is_cut: NDArray[np.bool_]
    is_occluded: NDArray[np.bool_]

    @classmethod
    def from_overlap(
        cls, found: Lumps, labels: NDArray[np.integer], shared: LabelOverlap, size_mm: NDArray[np.float64]
    ) -> _Lumps:
        """Return the lumps of a label picture (H, W), matched to rocks by their overlap."""
        count, match = len(found.lumps), shared.iou > _MATCH
        rock_of = np.full(count + 1, -1)
        rock_of[shared.lump[match]] = shared.rock[match]
        rock = rock_of[1:]
        shown = np.bincount(labels.ravel(), minlength=FINES + 1)[1 : count + 1] > 0
        return cls(
            size_mm=np.array([lump.size_mm for lump in found.lumps]),
            sigma_mm=np.array([lump.sigma_mm for lump in found.lumps]),
            rock=rock,
            true_mm=np.where(rock >= 0, size_mm[rock], np.nan),
            is_shown=shown,
            is_matched=(rock >= 0) & shown,
            is_cut=np.array([lump.cut for lump in found.lumps], bool),
            is_occluded=np.array([lump.occluded for lump in found.lumps], bool),
        )


def _mean_iou(shared: LabelOverlap, rocks: _Rocks) -> float:
    """Return the best IoU of each visible rock, averaged by area."""
    visible, area = rocks.is_visible, rocks.area_px
    best = np.zeros(len(area))
    np.maximum.at(best, shared.rock, shared.iou)
    return float((best * area)[visible].sum() / area[visible].sum()) if visible.any() else np.nan


def _over_score(
    is_large: NDArray[np.bool_], lumps: _Lumps, is_matched: NDArray[np.bool_], over_mm: float
) -> dict[str, Any]:
    """Return the scores of the rocks and lumps over the limit."""
    is_over = lumps.is_shown & (lumps.size_mm > over_mm)
    is_alarmed = np.zeros(len(is_large), bool)
    is_alarmed[lumps.rock[lumps.is_matched & is_over]] = True
    return {
        "rocks_over": int(is_large.sum()),
        "recall_over": _mean(is_matched[is_large]),
        "lumps_over": int(is_over.sum()),
        "precision_over": _mean(lumps.is_matched[is_over]),
        "alarm_recall": _mean(is_alarmed[is_large]),
        "alarm_precision": _mean((lumps.true_mm > over_mm)[is_over]),
    }


def _size_score(
    error: NDArray[np.float64],
    error_over_sigma: NDArray[np.float64],
    is_entire: NDArray[np.bool_],
    is_free: NDArray[np.bool_],
) -> dict[str, Any]:
    """Return the size errors of the uncut lumps, and of those that are also not occluded."""
    free, entire = error[is_free], error[is_entire]
    return {
        "sized": int(is_free.sum()),
        "size_bias": _median(free),
        "size_error": _median(np.abs(free)),
        "size_iqr": float(np.subtract(*np.quantile(free, [0.75, 0.25]))) if is_free.any() else np.nan,
        "sigma_ratio": compute_robust_sigma(error_over_sigma[is_free]),
        "all_sized": int(is_entire.sum()),
        "all_bias": _median(entire),
        "all_error": _median(np.abs(entire)),
    }


def _d50(size_mm: NDArray[np.float64], volume_mm3: NDArray[np.float64]) -> float:
    return _compute_percentiles(size_mm, volume_mm3)[1]


def _compute_percentiles(size_mm: NDArray[np.float64], volume_mm3: NDArray[np.float64]) -> tuple[float, ...]:
    """Return d10, d50, d80, d90."""
    if not len(size_mm):
        return (np.nan,) * len(SHARES)
    return tuple(float(size) for size in compute_passing_sizes(size_mm, volume_mm3, SHARES))


def _mean(values: NDArray[np.bool_]) -> float:
    return float(values.mean()) if values.size else np.nan


def _median(values: NDArray[np.float64]) -> float:
    return float(np.median(values)) if values.size else np.nan


_FULL = 0.5
"""Rows with a coverage below this share of the median row's are not compared."""


@dataclass(frozen=True, slots=True, eq=False)
class TrueHeap:
    """The rocks of a simulated frame on the core's grid of H × W pixels."""

    camera: Camera
    depth: DepthMap
    """True depth with a negligible σ."""
    rock: NDArray[np.int32]
    """(H, W) number of the rock that each pixel shows, -1: none."""
    size_mm: NDArray[np.float64]
    """(N,) of the rocks."""
    volume_mm3: NDArray[np.float64]
    """(N,) of the rocks."""

    @property
    def pixel_mm(self) -> float:
        """Width of a pixel on the rocks."""
        return float(np.median(self.depth.depth_mm[self.rock >= 0])) / float(self.camera.focal_px.mean())


def read_heap(truth: Path, frame: str | None = None) -> TrueHeap:
    """Read the heap of a truth folder of ``beltscape simulate``, of a moving belt as ``frame`` shows it.

    Raises
    ------
    InputError
        When it contains no scene with rocks, or several, or the frame is none of the moving belt's.
    """
    if not truth.is_dir():
        raise InputError(f"{truth}: no such folder; give truth/ of one loaded belt by beltscape simulate")
    rocks = sorted(truth.glob("*_rocks.npz"))
    if len(rocks) != 1:
        raise InputError(
            f"{truth}: holds {len(rocks)} *_rocks.npz; give truth/ of one loaded belt by beltscape simulate"
        )
    bodies = read_arrays(rocks[0])
    size, volume = (bodies[name].astype(np.float64) for name in ("size_mm", "volume_mm3"))
    seen = rocks[0].with_name(rocks[0].name.replace("_rocks", "_depth"))
    if not seen.is_file():
        raise InputError(f"{seen}: is missing beside {rocks[0].name}; simulate the scene again")
    arrays = read_arrays(seen)
    if rocks[0].name.startswith(_MOVING):
        arrays = _select_frame(arrays, truth, frame)
    depth = arrays["depth_mm"].astype(np.float32)
    rock = arrays["rock"].astype(np.int32) if "rock" in arrays else np.full(depth.shape, -1, np.int32)
    if depth.ndim != 2 or not (rock >= 0).any():
        raise InputError(f"{seen}: shows no rock in a single frame; simulate belt_loaded with rocks")
    valid = np.isfinite(depth)
    perfect = DepthMap(
        depth,
        np.where(valid, 0.01, np.nan).astype(np.float32),
        valid.astype(np.uint8),
        valid.astype(np.float32),
    )
    return TrueHeap(read_rig(truth / "rig.json").core_camera, perfect, rock, size, volume)


_MOVING = "belt_moving"
"""Name of a moving belt's scene."""


def _select_frame(
    arrays: Mapping[str, NDArray[Any]], truth: Path, frame: str | None
) -> dict[str, NDArray[Any]]:
    """Return the planes (H, W) of one frame of a moving belt."""
    names = [one["frame"] for one in read_json(truth / f"{_MOVING}.json")["frames"]]
    if frame not in names:
        raise InputError(
            f"{truth}: is of a moving belt with the frames {names[0]} to {names[-1]}, not {frame}; give one of its "
            "frames, or the folder of beltscape measure flow"
        )
    return {name: planes[names.index(frame)] for name, planes in arrays.items()}


def score_lumps_of_frame(
    heap: TrueHeap, frame: Path | None, settings: LumpSettings, over_mm: float
) -> LumpScore:
    """Score the lumps measured in a frame's folder, or in the true depth (None), which gives the upper bound.

    Only rows that the matcher covered are compared.

    Raises
    ------
    InputError
        When the frame has another size than the truth.
    """
    camera, depth = heap.camera, heap.depth
    if frame is not None:
        result = read_frame(frame)
        camera, depth = result.rig.core_camera, result.depth
    if depth.depth_mm.shape != heap.rock.shape:
        sizes = ["{1}×{0}".format(*shape) for shape in (depth.depth_mm.shape, heap.rock.shape)]
        raise InputError(f"{frame}: has {sizes[0]} pixels, its truth {sizes[1]}; give both of one capture")
    return score_lumps(
        measure_lumps(depth, camera, settings), heap.rock, heap.size_mm, heap.volume_mm3,
        pixel_mm=heap.pixel_mm, over_mm=over_mm, region=find_covered_rows(depth), measured=depth.measured,
    )  # fmt: skip


def find_covered_rows(depth: DepthMap) -> NDArray[np.bool_]:
    """Return the pixels (H, W) of the rows that the matcher covered."""
    full = depth.measured.mean(axis=1)
    rows = np.flatnonzero(full > _FULL * np.median(full))
    region = np.zeros(depth.depth_mm.shape, bool)
    if rows.size:
        region[rows[0] : rows[-1] + 1] = True
    return region
