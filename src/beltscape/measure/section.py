"""A surface that is the same all along the belt: its direction and its cross-section, fitted together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

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
        return np.interp(x_mm, self.x_mm[known], self.z_mm[known]).astype(np.float64)


def fit_section(
    points_mm: NDArray[np.float64], rotation: NDArray[np.float64], *, rounds: int = 8, turn_yaw: bool = True
) -> Section:
    """Section of points (N, 3) in the camera's frame, started from ``rotation`` (section_from_camera).

    Gauss-Newton on z = h(x) + y·(θ - φ·h'(x)): pitch θ, yaw φ and the free cross-section h together, with
    Tukey weights on the robust scatter. ``turn_yaw=False`` keeps the yaw (a flat belt does not tell it).
    """
    for _ in range(rounds):
        step = _Step.solve(points_mm @ rotation.T, turn_yaw=turn_yaw)
        rotation = _turned(rotation, step.pitch, step.yaw)
        if max(abs(step.pitch), abs(step.yaw)) < 1e-7:
            break
    step = _Step.solve(points_mm @ rotation.T, turn_yaw=turn_yaw)
    return Section(rotation, step.x, step.z, step.residual, step.noise, step.sigma)


def _turned(rotation: NDArray[np.float64], pitch: float, yaw: float) -> NDArray[np.float64]:
    """The frame whose y lies along (yaw, 1, pitch) of the old one."""
    along = np.array([yaw, 1.0, pitch]) / np.linalg.norm([yaw, 1.0, pitch])
    up = np.array([0.0, 0.0, 1.0]) - along[2] * along
    up /= np.linalg.norm(up)
    return np.stack([np.cross(along, up), along, up]) @ rotation


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
        x, y, z = points.T
        y = y - y.mean()
        nodes = np.linspace(x.min(), x.max(), _NODES)
        pitch = nodes[1] - nodes[0]
        place = np.clip((x - nodes[0]) / pitch, 0, _NODES - 1 - 1e-9)
        left = place.astype(np.intp)
        part = place - left
        index = np.arange(len(x))
        hats = sparse.csr_matrix(
            (np.r_[1 - part, part], (np.r_[index, index], np.r_[left, left + 1])), (len(x), _NODES)
        )
        height = _binned_medians(np.round(place).astype(np.intp), z)
        residual = z - hats @ height
        answer = np.zeros(2)
        covariance, noise = np.full((2, 2), np.inf), 0.0
        for _ in range(3):
            noise = 1.4826 * float(np.median(np.abs(residual))) + 1e-9
            weight = np.clip(1 - (residual / (4.685 * noise)) ** 2, 0, None) ** 2
            slope = np.diff(height)[left] / pitch
            lever = np.where(np.abs(slope) < _STEEPEST, slope, 0.0) * -y * turn_yaw
            height, answer, covariance = _solve(hats, np.column_stack([y, lever]), z, weight, height)
            residual = z - hats @ height - y * answer[0] - lever * answer[1]
        sigma = noise * np.sqrt(np.diag(covariance))
        counts = np.bincount(np.round(place).astype(np.intp), minlength=_NODES)
        known = np.where(counts >= 3, height, np.nan)
        return cls(answer[0], answer[1], nodes, known, residual, noise, (float(sigma[0]), float(sigma[1])))


def _binned_medians(label: NDArray[np.intp], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(_NODES,) median of the values of each label; empty ones interpolated."""
    order = np.lexsort((values, label))
    count = np.bincount(label, minlength=_NODES)
    first = np.cumsum(count) - count
    full = np.flatnonzero(count)
    medians = values[order[first[full] + count[full] // 2]]
    return np.interp(np.arange(_NODES), full, medians)


def _solve(
    hats: sparse.csr_matrix,
    turns: NDArray[np.float64],
    z: NDArray[np.float64],
    weight: NDArray[np.float64],
    before: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Weighted least squares for the section (K,) and the two turns (2,), with the turns' unit covariance."""
    weighted = hats.multiply(weight[:, None]).tocsr()
    corner = (weighted.T @ hats).toarray()
    ridge = 1e-6 * max(float(corner.diagonal().max()), 1e-12)
    corner[np.diag_indices(_NODES)] += ridge  # nodes without points stay where they were
    side = weighted.T @ turns
    base = weighted.T @ z + ridge * before
    inner = (turns * weight[:, None]).T @ turns
    solved = np.linalg.solve(corner, np.column_stack([side, base]))
    reduced = inner - side.T @ solved[:, :2]
    reduced[np.diag_indices(2)] += 1e-12 * inner[0, 0]
    covariance = np.linalg.inv(reduced)
    answer = covariance @ (turns.T @ (weight * z) - side.T @ solved[:, 2])
    return solved[:, 2] - solved[:, :2] @ answer, answer, covariance
