"""Slow drift of a rig by tie points of ordinary frames: what changed since a reference window, with its covariance.

A window sums the block medians of the residuals of many frames. Their change since the reference window of the same
rig is explained by movements of one camera, or of all, with their focal lengths. What lens models and matching leave
is in both windows and cancels. Images alone do not show a common scale of all baselines: it keeps its value.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from beltscape.core.arrays import Array
from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.pose_change import apply_pose_change
from beltscape.stereo.consistency.residuals import (
    BLOCKS,
    LEAST_IN_BLOCK,
    PairResiduals,
    compute_disparity_residuals,
    compute_pair_residuals,
    find_blocks,
)
from beltscape.stereo.consistency.tie_points import TiePoints

PARAMETERS = ("turn_x_rad", "turn_y_rad", "turn_z_rad", "shift_x_mm", "shift_y_mm", "shift_z_mm", "focal")
"""Of each camera, in its own frame; ``focal`` is the relative change of both focal lengths."""
COMMON, NOTHING = "all", "none"
"""What moved: all cameras, or none; else the name of one."""
LEAST_FRAMES = 20
"""Least number of frames of a window."""
_LEAST_IN_BLOCK = 6
"""Least number of frames that show points in a block: the scatter between them gives σ. With 20, rendered windows of
30 frames kept 5 of 36 medians after a movement, with 6 they keep 22."""
_STEPS = np.array([1e-5, 1e-5, 1e-5, 1e-2, 1e-2, 1e-2, 1e-5])
"""Steps of the numerical derivatives: some 0.01 px."""
_ALONE = np.array([0.02, 0.02, 0.02, 20.0, 20.0, 20.0, 0.01])
"""σ of a movement of one camera before it is measured: a knock, or a lens that was touched."""
_TOGETHER = np.array([5e-3, 5e-3, 5e-3, 3.0, 3.0, 3.0, 3e-3])
"""σ of each camera's part of a movement of all: a frame that warps, lenses that warm up."""
_SCALE_SIGMA = 5e-4
"""σ of the common scale of all baselines, which images do not show: aluminium of 20 K more grows by as much."""
_BIAS_PX = 0.01
"""Systematic change of the matching in a block, as other material lies there; rendered captures have 0.005 px."""
_BIAS_SHARE = 0.07
"""The same as a share of the change: matching reports 0.9 to 1.0 of a camera's turn in rendered frames (0.67 without
its refinement), and loses the points that moved farthest."""
_SURE = 0.999
"""Probability with which noise alone leaves less: below it nothing has moved."""
_DECISIVE = 9.0
"""A movement of one camera explains the change if that of all cameras lowers χ² by no more than chance and this."""


@dataclass(frozen=True, slots=True, eq=False)
class DriftWindow:
    """Block medians of the residuals of many frames under one rig."""

    names: tuple[str, ...]
    """The auxiliaries."""
    frames: int
    mean_px: Array
    """(S·B,) means over the frames of the medians: epipolar by auxiliary, then disparity by pair; NaN: too few."""
    variance_px2: Array
    """(S·B,) variances of these means, from the scatter between frames."""
    slopes: Array
    """(S·B, 7·C) mean derivatives by `PARAMETERS` of the core and of the auxiliaries."""
    width_px: int
    """Width of the core's images."""

    def to_document(self) -> dict[str, Any]:
        """Return what a later window is compared with, as plain values."""
        return {
            "names": list(self.names),
            "frames": self.frames,
            "width_px": self.width_px,
            "mean_px": [None if np.isnan(one) else round(float(one), 6) for one in self.mean_px],
            "variance_px2": [None if np.isnan(one) else float(f"{one:.4g}") for one in self.variance_px2],
        }


def read_window(document: Mapping[str, Any]) -> DriftWindow:
    """Return the window of a document; it has no slopes, which the later window gives."""
    mean, variance = (np.array(document[key], np.float64) for key in ("mean_px", "variance_px2"))
    names, frames, width_px = tuple(document["names"]), int(document["frames"]), int(document["width_px"])
    return DriftWindow(names, frames, mean, variance, np.empty((0, 0)), width_px)


class DriftAccumulator:
    """Sums the block medians of frames of one rig; bounded in memory."""

    def __init__(self, rig: Rig) -> None:
        self._rig, self._names = rig, rig.auxiliaries
        self._variants = _vary(rig)
        self._pairs = tuple(combinations(self._names, 2))
        size = (len(self._names) + len(self._pairs)) * BLOCKS[0] * BLOCKS[1]
        self._count = np.zeros(size)
        self._sum, self._squares = np.zeros(size), np.zeros(size)
        self._slopes = np.zeros((size, len(self._variants)))
        self.frames = 0

    def add(self, tie_points: TiePoints) -> None:
        """Add the tie points of a frame; one that lacks an auxiliary says nothing of it."""
        names = [name for name in self._names if name in tie_points.observed_px]
        pairs = {name: compute_pair_residuals(tie_points, self._rig, name) for name in names}
        base = self._sort_into_blocks(tie_points, pairs)
        medians = base.find_medians()
        known = np.isfinite(medians)
        self._count += known
        self._sum += np.where(known, medians, 0.0)
        self._squares += np.where(known, medians**2, 0.0)
        for column, (camera, rig, step) in enumerate(self._variants):
            affected = names if camera == rig.core else [name for name in names if name == camera]
            moved = {name: compute_pair_residuals(tie_points, rig, name) for name in affected}
            varied = self._sort_into_blocks(tie_points, {**pairs, **moved})
            self._slopes[:, column] += np.where(known, _average_change(base, varied, step), 0.0)
        self.frames += 1

    def close(self) -> DriftWindow:
        """Return the window so far and begin the next one."""
        with np.errstate(invalid="ignore", divide="ignore"):
            known = self._count >= _LEAST_IN_BLOCK
            mean = np.where(known, self._sum / self._count, np.nan)
            scatter = np.maximum(self._squares / self._count - mean**2, 0.0)
            # of Student's distribution: the scatter is known from as many frames only
            variance = np.where(known, scatter / (self._count - 3), np.nan)
            slopes = self._slopes / np.maximum(self._count, 1)[:, None]
        width_px = self._rig.core_camera.size_px[0]
        window = DriftWindow(self._names, self.frames, mean, variance, slopes, width_px)
        self._count[:], self._sum[:], self._squares[:], self._slopes[:] = 0, 0, 0, 0
        self.frames = 0
        return window

    def _sort_into_blocks(self, tie_points: TiePoints, pairs: Mapping[str, PairResiduals]) -> _Blocks:
        """Return all series of residuals by block; those of a camera that is not there are NaN."""
        missing = np.full(len(tie_points.core_px), np.nan)
        series = [pairs[name].epipolar_px if name in pairs else missing for name in self._names]
        series += [
            compute_disparity_residuals(pairs[one], pairs[other])
            if one in pairs and other in pairs
            else missing
            for one, other in self._pairs
        ]
        return _Blocks(find_blocks(tie_points.core_px, self._rig.core_camera.size_px), series)


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """Residuals of one frame with the block of each point."""

    block: NDArray[np.int64]
    """(N,)."""
    series: list[Array]
    """(N,) each."""

    def find_medians(self) -> Array:
        """Return (S·B,) medians; NaN where a block has too few points."""
        size = BLOCKS[0] * BLOCKS[1]
        medians = np.full((len(self.series), size), np.nan)
        for row, values in zip(medians, self.series, strict=True):
            good = np.isfinite(values)
            for block in np.flatnonzero(np.bincount(self.block[good], minlength=size) >= LEAST_IN_BLOCK):
                row[block] = np.median(values[good & (self.block == block)])
        return medians.ravel()


def _average_change(before: _Blocks, after: _Blocks, step: float) -> Array:
    """Return (S·B,) means over the blocks of the derivative of all series; 0 where nothing was found."""
    size, means = BLOCKS[0] * BLOCKS[1], list[Array]()
    for old, new in zip(before.series, after.series, strict=True):
        change = (new - old) / step
        good = np.isfinite(change)
        sums = np.bincount(before.block[good], change[good], size)
        means.append(sums / np.maximum(np.bincount(before.block[good], minlength=size), 1))
    return np.concatenate(means)


def _vary(rig: Rig) -> list[tuple[str, Rig, float]]:
    """Return camera, rig and step for a small step of each of `PARAMETERS` of each camera."""
    found: list[tuple[str, Rig, float]] = []
    for camera in (rig.core, *rig.auxiliaries):
        for index, step in enumerate(_STEPS):
            values = np.zeros(len(PARAMETERS))
            values[index] = step
            found.append((camera, apply_drift(rig, {camera: values}), float(step)))
    return found


def apply_drift(rig: Rig, changes: Mapping[str, Array]) -> Rig:
    """Return the rig after changes (7,) of cameras by `PARAMETERS`; the core's moves all others against it."""
    for name in sorted(changes, key=lambda name: name == rig.core):
        rig = apply_pose_change(rig, name, changes[name][:6])
        if changes[name][6]:
            camera = rig.cameras[name]
            scaled = replace(camera, focal_px=camera.focal_px * (1 + changes[name][6]))
            rig = replace(rig, cameras={**rig.cameras, name: scaled})
    return rig


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """Change of a rig since its reference window."""

    moved: str
    """Camera that moved, `COMMON` or `NOTHING`."""
    cameras: tuple[str, ...]
    """The core, then the auxiliaries."""
    change: Array
    """(7·C,) by `PARAMETERS`; 0 for what did not move."""
    covariance: Array
    """(7·C, 7·C)."""
    row_px: Mapping[str, tuple[float, float]]
    """By auxiliary: RMS change of the rows (epipolar residuals) and its σ."""
    chi_square: float
    """Change of the medians over their variances, before anything is fitted."""
    left: float
    """The same per degree of freedom after the fit, above 1: the covariance includes it."""
    medians: int
    """Number of medians that both windows have."""

    def get_changes(self) -> dict[str, Array]:
        """Return the changes (7,) by camera, of those that moved."""
        rows = dict(zip(self.cameras, self.change.reshape(-1, len(PARAMETERS)), strict=True))
        return {name: row for name, row in rows.items() if np.any(row)}


def estimate_drift(now: DriftWindow, reference: DriftWindow, rig: Rig) -> Drift:
    """Return what the rig has to change by so that a window's residuals become those of the reference window.

    Nothing has moved where noise explains the change; one camera has where a movement of all explains it no better.
    """
    cameras = (rig.core, *now.names)
    scale = now.width_px / reference.width_px  # of other images since, by matching.width_px
    difference = now.mean_px - scale * reference.mean_px
    variance = now.variance_px2 + scale**2 * reference.variance_px2 + 2 * _BIAS_PX**2
    variance = variance + (_BIAS_SHARE * difference) ** 2
    # disparities of all pairs hold the same information several times
    count, blocks = len(now.names), BLOCKS[0] * BLOCKS[1]
    repeated = np.repeat([1.0] * count + [max(1.0, count / 2)] * (len(difference) // blocks - count), blocks)
    used = np.isfinite(difference) & np.isfinite(variance)
    problem = _Problem(difference[used], (repeated * variance)[used], now.slopes[used], rig, cameras)
    rows = {
        name: _describe_rows(difference[place], variance[place])
        for name, place in zip(now.names, np.arange(count * blocks).reshape(count, blocks), strict=True)
    }
    fit = problem.select()
    chi_square = problem.compute_chi_square()
    return Drift(fit.moved, cameras, fit.change, fit.covariance, rows, chi_square, fit.left, int(used.sum()))


def _describe_rows(change_px: Array, variance_px2: Array) -> tuple[float, float]:
    good = np.isfinite(change_px) & np.isfinite(variance_px2)
    if not good.any():
        return float("nan"), float("nan")
    rms = float(np.sqrt(np.mean(change_px[good] ** 2)))
    return rms, float(np.sqrt(np.mean(variance_px2[good])))


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    moved: str
    change: Array
    covariance: Array
    chi_square: float
    left: float


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """Least squares of the change of all medians."""

    value: Array
    """(M,) px."""
    variance: Array
    """(M,) px²."""
    slopes: Array
    """(M, 7·C)."""
    rig: Rig
    cameras: tuple[str, ...]

    def compute_chi_square(self) -> float:
        return float((self.value**2 / self.variance).sum())

    def select(self) -> _Fit:
        """Return the simplest explanation that the medians allow."""
        together = self._fit_all()
        width = len(PARAMETERS)
        size = width * len(self.cameras)
        if not len(self.value) or self.compute_chi_square() <= together.left * chi2.ppf(
            _SURE, len(self.value)
        ):
            nothing = np.zeros(size)
            return replace(together, moved=NOTHING, change=nothing)
        alone = min(
            (self._fit_one(number) for number in range(len(self.cameras))), key=lambda one: one.chi_square
        )
        more = chi2.ppf(_SURE, size - width) + _DECISIVE
        return alone if alone.chi_square <= together.chi_square + together.left * more else together

    def _fit_one(self, number: int) -> _Fit:
        width = len(PARAMETERS)
        columns = width * number + np.arange(width)
        return self._fit(columns, np.diag(_ALONE**-2.0), self.cameras[number])

    def _fit_all(self) -> _Fit:
        """Return the movement of all auxiliaries; the core's is one of all others, and its focal length is free."""
        width, count = len(PARAMETERS), len(self.cameras)
        columns = np.concatenate([[width - 1], np.arange(width, width * count)])
        information = np.diag(np.append(_TOGETHER[-1], np.tile(_TOGETHER, count - 1)) ** -2.0)
        scale = np.zeros(len(columns))
        baselines = [self.rig.cam_from_core[name].translation_mm for name in self.cameras[1:]]
        total = float(np.sum(np.square(baselines)))
        for index, baseline in enumerate(baselines):
            scale[1 + width * index + np.arange(3, 6)] = baseline / total
        return self._fit(columns, information + np.outer(scale, scale) / _SCALE_SIGMA**2, COMMON)

    def _fit(self, columns: NDArray[np.int64], information: Array, moved: str) -> _Fit:
        slopes, weight = self.slopes[:, columns], 1 / self.variance
        inverse = np.linalg.inv((slopes * weight[:, None]).T @ slopes + information)
        step = -inverse @ (slopes.T @ (weight * self.value))
        left = self.value + slopes @ step
        chi_square = float((left**2 * weight).sum() + step @ information @ step)
        freedom = max(len(self.value) - len(columns), 1)
        excess = max(float((left**2 * weight).sum()) / freedom, 1.0)
        size = self.slopes.shape[1]
        change, covariance = np.zeros(size), np.zeros((size, size))
        change[columns] = step
        covariance[np.ix_(columns, columns)] = excess * inverse
        return _Fit(moved, change, covariance, chi_square, excess)
