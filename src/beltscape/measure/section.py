"""A surface that is the same all along the belt: its direction and its cross-section, fitted together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

_NODES = 160
_STEEPEST = 2.0
"""Slopes above this are steps to the floor or a frame, no belt: they tell nothing of the yaw."""


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """A generalised cylinder z = h(x), invariant along y, in a frame turned from the camera's."""

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
        """Height of the section at any x, held constant beyond its ends."""
        known = np.isfinite(self.z_mm)
        return np.interp(x_mm, self.x_mm[known], self.z_mm[known])


def fit_section(
    points_mm: NDArray[np.float64], rotation: NDArray[np.float64], *, rounds: int = 8, turn_yaw: bool = True
) -> Section:
    """Section of points (N, 3) in the camera's frame, started from ``rotation`` (section_from_camera).

    Gauss-Newton on z = h(x) + y·(θ - φ·h'(x)): pitch θ, yaw φ and the free cross-section h together, with
    Tukey weights on the robust scatter. ``turn_yaw=False`` keeps the yaw (a flat belt does not tell it).
    """
    for _ in range(rounds):
        step = _Step.solve(_apply(rotation, points_mm), turn_yaw=turn_yaw)
        rotation = _turned(rotation, step.pitch, step.yaw)
        if max(abs(step.pitch), abs(step.yaw)) < 1e-7:
            break
    step = _Step.solve(_apply(rotation, points_mm), turn_yaw=turn_yaw)
    return Section(rotation, step.x, step.z, step.residual, step.noise, step.sigma)


def _apply(rotation: NDArray[np.float64], points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, N) turned coordinates; einsum, for a threaded product of so narrow a matrix wastes more than it gains."""
    return np.einsum("ij,nj->in", rotation, points_mm)


def _turned(rotation: NDArray[np.float64], pitch: float, yaw: float) -> NDArray[np.float64]:
    """The frame whose y lies along (yaw, 1, pitch) of the old one."""
    along = np.array([yaw, 1.0, pitch]) / np.linalg.norm([yaw, 1.0, pitch])
    up = np.array([0.0, 0.0, 1.0]) - along[2] * along
    up /= np.linalg.norm(up)
    return np.array([np.cross(along, up), along, up], dtype=np.float64) @ rotation


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    pitch: float
    yaw: float
    x: NDArray[np.float64]
    z: NDArray[np.float64]
    residual: NDArray[np.float64]
    noise: float
    sigma: tuple[float, float]

    @classmethod
    def solve(cls, points: NDArray[np.float64], *, turn_yaw: bool) -> _Step:
        x, y, z = points
        y = y - y.mean()
        nodes = np.linspace(x.min(), x.max(), _NODES)
        hats = _Hats.at(x, nodes)
        height = _binned_medians(hats.nearest, z)
        residual = z - hats.value(height)
        answer = np.zeros(2)
        covariance, noise = np.full((2, 2), np.inf), 0.0
        for _ in range(3):
            noise = 1.4826 * float(np.median(np.abs(residual))) + 1e-9
            weight = np.clip(1 - (residual / (4.685 * noise)) ** 2, 0, None) ** 2
            slope = (np.diff(height) / np.diff(nodes))[hats.left]
            lever = np.where(np.abs(slope) < _STEEPEST, slope, 0.0) * -y * turn_yaw
            height, answer, covariance = _solve(hats, (y, lever), z, weight, height)
            residual = z - hats.value(height) - y * answer[0] - lever * answer[1]
        sigma = noise * np.sqrt(np.diag(covariance))
        counts = np.bincount(hats.nearest, minlength=_NODES)
        known = np.where(counts >= 3, height, np.nan)
        return cls(answer[0], answer[1], nodes, known, residual, noise, (float(sigma[0]), float(sigma[1])))


@dataclass(frozen=True, slots=True, eq=False)
class _Hats:
    """Piecewise linear interpolation between nodes: each point has a node to its left and a part of the next."""

    left: NDArray[np.intp]
    part: NDArray[np.float64]

    @classmethod
    def at(cls, x: NDArray[np.float64], nodes: NDArray[np.float64]) -> _Hats:
        place = np.clip((x - nodes[0]) / (nodes[1] - nodes[0]), 0, len(nodes) - 1 - 1e-9)
        left = place.astype(np.intp)
        return cls(left, place - left)

    @property
    def nearest(self) -> NDArray[np.intp]:
        return self.left + (self.part > 0.5)

    def value(self, height: NDArray[np.float64]) -> NDArray[np.float64]:
        """Interpolated at the points."""
        return height[self.left] * (1 - self.part) + height[self.left + 1] * self.part

    def gather(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The transposed operation: the points' values summed to the nodes."""
        lower = np.bincount(self.left, values * (1 - self.part), _NODES)
        return np.asarray(lower + np.bincount(self.left + 1, values * self.part, _NODES), np.float64)


def _binned_medians(label: NDArray[np.intp], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(_NODES,) median of the values of each label; empty ones interpolated."""
    order = np.lexsort((values, label))
    count = np.bincount(label, minlength=_NODES)
    first = np.cumsum(count) - count
    full = np.flatnonzero(count)
    medians = values[order[first[full] + count[full] // 2]]
    return np.interp(np.arange(_NODES), full, medians)


def _solve(
    hats: _Hats,
    turns: tuple[NDArray[np.float64], NDArray[np.float64]],
    z: NDArray[np.float64],
    weight: NDArray[np.float64],
    before: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Weighted least squares for the section (K,) and the two turns (2,), with the turns' unit covariance."""
    beside = np.bincount(hats.left, weight * (1 - hats.part) * hats.part, _NODES)
    band = np.stack([np.roll(beside, 1), hats.gather(weight) - beside - np.roll(beside, 1)])
    ridge = 1e-6 * max(float(band[1].max()), 1e-12)
    band[1] += ridge  # nodes without points stay where they were
    side = np.column_stack([hats.gather(weight * turn) for turn in turns])
    inner = np.array([[np.sum(weight * one * two) for two in turns] for one in turns])
    base = hats.gather(weight * z) + ridge * before
    solved = np.asarray(solveh_banded(band, np.column_stack([side, base])), np.float64)
    reduced = inner - side.T @ solved[:, :2]
    reduced[np.diag_indices(2)] += 1e-12 * inner[0, 0]
    covariance = np.asarray(np.linalg.inv(reduced), np.float64)
    answer = covariance @ (np.array([np.sum(turn * weight * z) for turn in turns]) - side.T @ solved[:, 2])
    return solved[:, 2] - solved[:, :2] @ answer, answer, covariance
