"""Fit of a lens with four distortion coefficients to one with five, for programs without k3."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.camera import Camera

_SAMPLES = 64
"""Pixels along each side of the grid on which the lens is fitted; distortion is smooth between them."""


def fit_without_k3(camera: Camera) -> tuple[NDArray[np.float64], float, float]:
    """Fit k1, k2, p1, p2 (4,) without k3; return them with the RMS and the largest shift of the image, px.

    The camera matrix is kept. The model is linear in its coefficients, so the fit over a grid of pixels is one
    linear least-squares problem.
    """
    if camera.distortion[4] == 0:
        return camera.distortion[:4].copy(), 0.0, 0.0
    width, height = camera.size_px
    u, v = np.meshgrid(np.linspace(0, width - 1, _SAMPLES), np.linspace(0, height - 1, _SAMPLES))
    ideal = camera.undistort(np.stack([u, v], axis=-1).reshape(-1, 2))
    ideal = ideal[np.isfinite(ideal).all(axis=-1)]
    moved_px = (camera.distort(ideal) - ideal) * camera.focal_px
    columns_px = _terms(ideal) * camera.focal_px[:, None]
    solution = np.linalg.lstsq(columns_px.reshape(-1, 4), moved_px.reshape(-1), rcond=None)[0]
    coefficients = np.asarray(solution, dtype=np.float64)
    error_px = np.asarray(np.linalg.norm(columns_px @ coefficients - moved_px, axis=-1), np.float64)
    return coefficients, float(np.sqrt(np.mean(error_px**2))), float(error_px.max())


def _terms(ideal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the derivatives (N, 2, 4) of the distorted x/z, y/z (N, 2) with respect to k1, k2, p1, p2."""
    x, y = ideal.T
    r2 = x * x + y * y
    along_x = [x * r2, x * r2 * r2, 2 * x * y, r2 + 2 * x * x]
    along_y = [y * r2, y * r2 * r2, r2 + 2 * y * y, 2 * x * y]
    return np.stack([np.stack(along_x, axis=-1), np.stack(along_y, axis=-1)], axis=1)
