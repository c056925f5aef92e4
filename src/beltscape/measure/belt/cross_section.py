"""The belt as a generalised cylinder: its direction and its cross-section, fitted together.

The residuals about one constant cross-section are the deviation: sag, waves and smooth errors of the rig, and how
errors of neighbouring pixels correlate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.linalg import solveh_banded

from beltscape.core.empty_belt import BeltDeviation
from beltscape.core.statistics import MAD_TO_SIGMA, compute_biweights

_NODES, _LEAST_NODES = 160, 40
"""Nodes over the measured width: 5 mm apart on a belt of 800 mm."""
_NODE_SPACING = 1.5
"""Nodes are at least this multiple of the points' usual distance apart, so that each has a column of points."""
STEP_MM = 12.0
"""Points off the section by more than this lie below or above the belt, beyond its far end."""
_MAX_SLOPE = 2.0
"""Steeper slopes are steps to the floor or a frame, not the belt: they do not count towards the yaw."""


@dataclass(frozen=True, slots=True, eq=False)
class BeltCrossSection:
    """A generalised cylinder z = h(x), invariant along y, in a frame rotated against the camera's."""

    rotation: NDArray[np.float64]
    """(3, 3) section_from_camera; rows are x across, y along, z up."""
    x_mm: NDArray[np.float64]
    """(K,) nodes of the piecewise linear cross-section, evenly spaced."""
    z_mm: NDArray[np.float64]
    """(K,) its height there; NaN where nothing was measured."""
    residual_mm: NDArray[np.float64]
    """(N,) of the points given."""
    noise_mm: float
    """Robust scatter of the points about the section."""
    sigma_rad: tuple[float, float]
    """One standard deviation of pitch (about x) and yaw (about z), for independent points."""

    def height_mm(self, x_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the height of the section at any x, constant beyond its ends."""
        measured = np.isfinite(self.z_mm)
        return np.interp(x_mm, self.x_mm[measured], self.z_mm[measured])


def fit_cross_section(
    points_mm: NDArray[np.float64], rotation: NDArray[np.float64], *, rounds: int = 8, turn_yaw: bool = True
) -> BeltCrossSection:
    """Fit the section to points (N, 3) in the camera's frame, starting from ``rotation`` (section_from_camera).

    Gauss-Newton on z = h(x) + y·(θ - φ·h'(x)): pitch θ, yaw φ and the free cross-section h together, with
    Tukey weights on the robust scatter. ``turn_yaw=False`` keeps the yaw (a flat belt does not determine it).
    """
    for _ in range(rounds):
        step = _GaussNewtonStep.solve(_rotate_points(rotation, points_mm), turn_yaw=turn_yaw)
        rotation = _rotate_frame(rotation, step.pitch, step.yaw)
        if max(abs(step.pitch), abs(step.yaw)) < 1e-7:
            break
    step = _GaussNewtonStep.solve(_rotate_points(rotation, points_mm), turn_yaw=turn_yaw)
    return BeltCrossSection(rotation, step.x, step.z, step.residual, step.noise, step.sigma)


def refine_section(
    x_mm: NDArray[np.float64], z_mm: NDArray[np.float64], points_mm: NDArray[np.float64], pixel_mm: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the cross-section on nodes two pixels apart, from medians of the residuals: folds stay sharp."""
    x, z = points_mm[..., 0].ravel(), points_mm[..., 2].ravel()
    inside = (x > x_mm[0]) & (x < x_mm[-1])  # NaN is not
    x, off = x[inside], z[inside] - np.interp(x[inside], x_mm, z_mm)
    on = np.abs(off) <= STEP_MM  # what lies below or above, beyond the belt's far end, is no belt
    x, off = x[on], off[on]
    nodes = np.linspace(float(x_mm[0]), float(x_mm[-1]), max(len(x_mm), int(np.ptp(x_mm) / (2 * pixel_mm))))
    own = np.rint((x - nodes[0]) / (nodes[1] - nodes[0])).astype(np.intp)
    order = _sort_within_labels(own, off, len(nodes))
    count = np.bincount(own, minlength=len(nodes))
    first = np.cumsum(count) - count
    full = np.flatnonzero(count >= 20)
    if len(full) < 2:
        return x_mm, z_mm
    median = off[order[first[full] + count[full] // 2]]
    return nodes, np.interp(nodes, x_mm, z_mm) + np.interp(nodes, nodes[full], median)


def estimate_node_sigma(
    nodes_mm: NDArray[np.float64], x_mm: NDArray[np.float64], noise_mm: float, area_px: float
) -> NDArray[np.float64]:
    """Return σ (N,) of the nodes' heights; a node averages the points within half a node spacing on either side.

    ``x_mm`` (M,) are the measured points, ``area_px`` the pixels that share one independent error.
    """
    nearest = np.rint(np.interp(x_mm, nodes_mm, np.arange(len(nodes_mm)))).astype(np.intp)
    count = np.bincount(nearest, minlength=len(nodes_mm))
    return noise_mm * np.sqrt(np.minimum(area_px / np.maximum(count, 1), 1.0))


def _rotate_points(rotation: NDArray[np.float64], points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rotated coordinates (3, N); einsum, because a threaded product of so narrow a matrix is slower."""
    return np.einsum("ij,nj->in", rotation, points_mm)


def _rotate_frame(rotation: NDArray[np.float64], pitch: float, yaw: float) -> NDArray[np.float64]:
    """Return the frame whose y lies along (yaw, 1, pitch) of the given one."""
    along = np.array([yaw, 1.0, pitch]) / np.linalg.norm([yaw, 1.0, pitch])
    up = np.array([0.0, 0.0, 1.0]) - along[2] * along
    up /= np.linalg.norm(up)
    return np.array([np.cross(along, up), along, up], dtype=np.float64) @ rotation


@dataclass(frozen=True, slots=True, eq=False)
class _GaussNewtonStep:
    pitch: float
    yaw: float
    x: NDArray[np.float64]
    z: NDArray[np.float64]
    residual: NDArray[np.float64]
    noise: float
    sigma: tuple[float, float]

    @classmethod
    def solve(cls, points: NDArray[np.float64], *, turn_yaw: bool) -> _GaussNewtonStep:
        x, y, z = points
        y = y - y.mean()
        nodes = np.linspace(float(x.min()), float(x.max()), _choose_node_count(x, y))
        hats = _HatFunctions.at(x, nodes)
        height = _compute_bin_medians(hats.nearest, z, hats.size)
        residual = z - hats.value(height)
        answer = np.zeros(2)
        covariance, noise = np.full((2, 2), np.inf), 0.0
        for _ in range(3):
            noise = MAD_TO_SIGMA * float(np.median(np.abs(residual))) + 1e-9
            weight = compute_biweights(residual, noise)
            slope = (np.diff(height) / np.diff(nodes))[hats.left]
            lever = np.where(np.abs(slope) < _MAX_SLOPE, slope, 0.0) * -y * turn_yaw
            height, answer, covariance = _solve_normal_equations(hats, (y, lever), z, weight, height)
            residual = z - hats.value(height) - y * answer[0] - lever * answer[1]
        sigma = noise * np.sqrt(np.diag(covariance))
        counts = np.bincount(hats.nearest, minlength=hats.size)
        measured = np.where(counts >= 3, height, np.nan)
        return cls(answer[0], answer[1], nodes, measured, residual, noise, (float(sigma[0]), float(sigma[1])))


@dataclass(frozen=True, slots=True, eq=False)
class _HatFunctions:
    """Piecewise linear interpolation between nodes: each point's left node and the weight of the next."""

    left: NDArray[np.intp]
    part: NDArray[np.float64]
    size: int

    @classmethod
    def at(cls, x: NDArray[np.float64], nodes: NDArray[np.float64]) -> _HatFunctions:
        place = np.clip((x - nodes[0]) / (nodes[1] - nodes[0]), 0, len(nodes) - 1 - 1e-9)
        left = place.astype(np.intp)
        return cls(left, place - left, len(nodes))

    @property
    def nearest(self) -> NDArray[np.intp]:
        return self.left + (self.part > 0.5)

    def value(self, height: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return node heights (K,) interpolated at the points."""
        return height[self.left] * (1 - self.part) + height[self.left + 1] * self.part

    def gather(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the points' values summed to the nodes, the transpose of `value`."""
        lower = np.bincount(self.left, values * (1 - self.part), self.size)
        return np.asarray(lower + np.bincount(self.left + 1, values * self.part, self.size), np.float64)


def _choose_node_count(x: NDArray[np.float64], y: NDArray[np.float64]) -> int:
    """Return the number of nodes for points at x, y (N,)."""
    spacing = float(np.sqrt(np.ptp(x) * np.ptp(y) / len(x)))
    return int(np.clip(np.ptp(x) / (_NODE_SPACING * max(spacing, 1e-9)), _LEAST_NODES, _NODES))


def _compute_bin_medians(
    label: NDArray[np.intp], values: NDArray[np.float64], size: int
) -> NDArray[np.float64]:
    """Return the median of the values of each label (size,); empty ones are interpolated."""
    order = _sort_within_labels(label, values, size)
    count = np.bincount(label, minlength=size)
    first = np.cumsum(count) - count
    full = np.flatnonzero(count)
    medians = values[order[first[full] + count[full] // 2]]
    return np.interp(np.arange(size), full, medians)


def _sort_within_labels(label: NDArray[np.intp], values: NDArray[np.float64], size: int) -> NDArray[np.intp]:
    """Return the order (N,) by labels below ``size``, then by values; labels of 16 bits are sorted in linear time."""
    by_value = np.argsort(values)
    return by_value[np.argsort(label[by_value].astype(np.min_scalar_type(size)), kind="stable")]


def _solve_normal_equations(
    hats: _HatFunctions,
    turns: tuple[NDArray[np.float64], NDArray[np.float64]],
    z: NDArray[np.float64],
    weight: NDArray[np.float64],
    previous: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Solve weighted least squares for the section (K,) and the two turns (2,); also return the turns' covariance."""
    weights = weight * (1 - hats.part) * hats.part
    beside = cast("NDArray[np.float64]", np.bincount(hats.left, weights, hats.size))
    band = np.stack([np.roll(beside, 1), hats.gather(weight) - beside - np.roll(beside, 1)])
    ridge = 1e-6 * max(float(band[1].max()), 1e-12)
    band[1] += ridge  # nodes without points keep their height
    side = np.column_stack([hats.gather(weight * turn) for turn in turns])
    inner = np.array([[np.sum(weight * one * two) for two in turns] for one in turns])
    base = hats.gather(weight * z) + ridge * previous
    solved = np.asarray(solveh_banded(band, np.column_stack([side, base])), np.float64)
    reduced = inner - side.T @ solved[:, :2]
    reduced[np.diag_indices(2)] += 1e-12 * inner[0, 0]
    covariance = np.asarray(np.linalg.inv(reduced), np.float64)
    answer = covariance @ (np.array([np.sum(turn * weight * z) for turn in turns]) - side.T @ solved[:, 2])
    return solved[:, 2] - solved[:, :2] @ answer, answer, covariance


_NODES_ACROSS = 24
"""Nodes over the belt's width; the same spacing holds along the belt."""
_MIN_SIGNIFICANCE = 2.0
"""A deviation is significant where the nodes' mean square is at least this multiple of their mean σ²."""
_MIN_RMS_MM = 0.03
"""Least root mean square of the nodes: smaller ones come from folds that lie between two nodes of the section."""
_BLOCK_PX = 64
"""Side of the larger blocks; the smaller ones have half of it."""


@dataclass(frozen=True, slots=True)
class ErrorCorrelation:
    """Errors of a depth map as patches of fully correlated pixels plus a slow part that does not average out."""

    area_px: float
    """Pixels whose errors act as one (the integral of the autocorrelation); 1 for independent pixels."""
    drift_mm: float
    """Standard deviation of the slow part."""


def estimate_correlation(residual_mm: NDArray[np.float64], noise_mm: float) -> ErrorCorrelation:
    """Estimate the correlation of residuals (H, W) mm, NaN where there are none, of robust scatter ``noise_mm``.

    The variance of means over blocks of 32 and 64 pixels is compared: the part due to patches falls with the
    block's area, the slow part does not. The slow part counts only where it is significant.
    """
    if noise_mm <= 0:
        return ErrorCorrelation(1.0, 0.0)
    clipped = np.clip(residual_mm, -3 * noise_mm, 3 * noise_mm)
    small, _ = _block_mean_square(clipped, _BLOCK_PX // 2)
    large, blocks = _block_mean_square(clipped, _BLOCK_PX)
    if not blocks:
        return ErrorCorrelation(100.0, 0.0)
    slow = (large - small / 4) * 4 / 3
    slow = max(0.0, slow - 2 * large * np.sqrt(2.0 / blocks))
    square = float(np.nanmean(clipped**2))
    side = _BLOCK_PX // 2
    apparent = np.sqrt(max(small - slow, 0.0) / max(square, 1e-30)) * side
    # the block's border cuts off a window's triangular autocorrelation: c · (1 - c / 3 side) remains; and the
    # fitted cross-section absorbs the error that a block shares with its column
    apparent /= np.sqrt(1 - side / max(residual_mm.shape[0], 2 * side))
    area = (1.5 * side * (1 - np.sqrt(max(0.0, 1 - 4 * apparent / (3 * side))))) ** 2
    return ErrorCorrelation(float(np.clip(area, 1.0, side**2)), float(np.sqrt(slow)))


def _block_mean_square(residual: NDArray[np.float64], side: int) -> tuple[float, int]:
    """Return the mean square of the block means, and the number of blocks that are mostly measured."""
    height, width = (n // side * side for n in residual.shape)
    blocks = residual[:height, :width].reshape(height // side, side, width // side, side)
    count = np.isfinite(blocks).sum(axis=(1, 3))
    full = count >= 0.7 * side * side
    if not full.any():
        return 0.0, 0
    means = cast("NDArray[np.float64]", np.nansum(blocks, axis=(1, 3))[full] / count[full])
    return float(np.mean(means**2)), int(full.sum())


def fit_deviation(
    points_mm: NDArray[np.float64], residual_mm: NDArray[np.float64], noise_mm: float, patch_px: float
) -> BeltDeviation | None:
    """Fit the deviation to points (H, W, 3) in the belt frame with heights over the cross-section (H, W).

    The errors of ``patch_px`` neighbouring pixels are taken as fully correlated. Nodes are robust means over
    their cells; the result is None where they scatter no more than such means do.
    """
    good = np.isfinite(residual_mm) & (np.abs(residual_mm) < 6 * noise_mm + 0.01 * np.nanstd(residual_mm))
    good |= np.isfinite(residual_mm) & (np.abs(residual_mm) < _inlier_limit_mm(residual_mm))
    if good.sum() < 1000:
        return None
    x, y, off = points_mm[..., 0][good], points_mm[..., 1][good], residual_mm[good]
    edges = [np.quantile(values, [0.001, 0.999]) for values in (x, y)]
    step = float(np.ptp(edges[0])) / _NODES_ACROSS
    nodes = [
        np.linspace(float(low), float(high), max(3, round((high - low) / step) + 1)) for low, high in edges
    ]
    column, row = (
        np.rint(np.interp(values, own, np.arange(len(own)))).astype(np.intp)
        for values, own in zip((x, y), nodes, strict=True)
    )
    shape = (len(nodes[1]), len(nodes[0]))
    cell = row * shape[1] + column
    count = np.bincount(cell, minlength=shape[0] * shape[1]).reshape(shape).astype(np.float64)
    weight = np.ones(len(off))
    mean, scale = np.zeros(shape), noise_mm
    for _ in range(3):  # Tukey weights about each node's mean
        total = np.bincount(cell, weight, shape[0] * shape[1]).reshape(shape)
        mean = np.bincount(cell, weight * off, shape[0] * shape[1]).reshape(shape) / np.maximum(total, 1e-9)
        left = off - mean.ravel()[cell]
        scale = MAD_TO_SIGMA * float(np.median(np.abs(left))) + 1e-9
        weight = compute_biweights(left, scale)
    full = count >= 0.1 * np.median(count[count > 0])
    sigma = scale * np.sqrt(np.minimum(patch_px / np.maximum(count, 1), 1.0))
    real = float(np.mean(mean[full] ** 2))
    if real < _MIN_SIGNIFICANCE * np.mean(sigma[full] ** 2) or real < _MIN_RMS_MM**2:
        return None
    nearest = ndimage.distance_transform_edt(~full, return_distances=False, return_indices=True)
    assert isinstance(nearest, np.ndarray)
    height = mean[tuple(nearest)]
    return BeltDeviation(
        nodes[0], nodes[1], height, np.where(full, sigma, np.hypot(scale, np.std(mean[full])))
    )


def _inlier_limit_mm(residual_mm: NDArray[np.float64]) -> float:
    """Return the limit of residuals that excludes gross errors and steps, but no sag."""
    measured = residual_mm[np.isfinite(residual_mm)]
    return (
        6 * MAD_TO_SIGMA * float(np.median(np.abs(measured - np.median(measured)))) if len(measured) else 0.0
    )
