"""A robust plane through points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.statistics import MAD_TO_SIGMA, compute_biweights


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """The plane of the points p with normal · p = offset."""

    normal: NDArray[np.float64]
    """(3,) unit, z positive."""
    offset_mm: float
    """Distance of the plane from the origin along the normal."""
    rms_mm: float
    """Robust scatter of the points about it."""
    sigma_rad: float
    """One standard deviation of the normal's direction (the worse axis), for independent points."""


def fit_plane(points_mm: NDArray[np.float64]) -> Plane:
    """Fit the plane z = a + b·x + c·y to points (N, 3), N ≥ 3, with Tukey weights on the robust scatter."""
    middle = np.median(points_mm, axis=0)
    local = points_mm - middle
    design = np.column_stack([np.ones(len(local)), local[:, :2]])
    weight = np.ones(len(local))
    answer, noise, normal_matrix = np.zeros(3), 0.0, np.eye(3)
    for _ in range(8):
        normal_matrix = (design * weight[:, None]).T @ design
        answer = np.linalg.solve(normal_matrix, design.T @ (weight * local[:, 2]))
        residual = local[:, 2] - design @ answer
        noise = MAD_TO_SIGMA * float(np.median(np.abs(residual))) + 1e-9
        weight = compute_biweights(residual, noise)
    normal = np.array([-answer[1], -answer[2], 1.0])
    normal /= np.linalg.norm(normal)
    sigma = noise * np.sqrt(np.diag(np.linalg.inv(normal_matrix))[1:].max())
    return Plane(normal, float(normal @ (middle + np.array([0.0, 0.0, answer[0]]))), noise, float(sigma))
