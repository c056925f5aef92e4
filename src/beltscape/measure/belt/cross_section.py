"""The belt as a generalised cylinder: its direction and its cross-section, fitted together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from beltscape.core.statistics import MAD_TO_SIGMA, compute_biweights

_NODES, _LEAST_NODES = 160, 40
"""Nodes over the measured width: 5 mm apart on a belt of 800 mm."""
_NODE_SPACING = 1.5
"""Nodes are at least this multiple of the points' usual distance apart, so that each has a column of points."""
_MAX_SLOPE = 2.0
"""Steeper slopes are steps to the floor or a frame, not the belt: they do not count towards the yaw."""


@dataclass(frozen=True, slots=True, eq=False)
class CrossSection:
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
) -> CrossSection:
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
    return CrossSection(rotation, step.x, step.z, step.residual, step.noise, step.sigma)


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
    order = np.lexsort((values, label))
    count = np.bincount(label, minlength=size)
    first = np.cumsum(count) - count
    full = np.flatnonzero(count)
    medians = values[order[first[full] + count[full] // 2]]
    return np.interp(np.arange(size), full, medians)


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
