"""Saddle model of a chessboard corner: two crossing blurred edges, fitted to the pixels by least squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

Array = NDArray[np.float64]

PARAMETERS = 9
"""Parameters of a corner."""
BLUR_PX = 0.3, 8.0
"""Bounds of the blur: about a pixel's own width, and a blur in which no corner is visible."""
CONVERGED_PX = 5e-4
"""The fit has converged if all corners move by less."""
MAX_STEPS = 10
"""Iterations of the fit at most."""


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """Pixels around n corners, m each."""

    x: Array
    """(n, m) px to the right of the corner's start."""
    y: Array
    """(n, m) px below the corner's start."""
    values: Array
    """(n, m) grey values."""
    used: Array
    """(n, m) 1 where a pixel is used, else 0."""


@dataclass(frozen=True, slots=True, eq=False)
class Saddles:
    """I = m + g·(x − x₀) + c·erf(d₁/√2s)·erf(d₂/√2s), with the distances d₁, d₂ of a pixel from two straight edges.

    The model is antisymmetric across each edge, so effects of ink, exposure or gamma that are alike on all sides do
    not bias x₀.
    """

    parameters: Array
    """(n, 9) x₀, y₀ (px), the directions θ₁, θ₂ of the edges' normals (rad), ln s, m, g (2, per px), c."""

    @property
    def offset_px(self) -> Array:
        """(n, 2) offset from the corners' start."""
        return self.parameters[:, :2]

    @property
    def blur_px(self) -> Array:
        """(n,) standard deviation of the Gaussian that blurs the edges."""
        return np.exp(self.parameters[:, 4])

    @property
    def contrast(self) -> Array:
        """(n,) half of the difference between light and dark squares."""
        return np.abs(self.parameters[:, 8])

    def linearise(self, windows: Windows) -> tuple[Array, Array]:
        """Return grey values (n, m) and their derivatives (n, 9, m) by the parameters."""
        p = self.parameters[:, :, None]
        x, y, width = windows.x - p[:, 0], windows.y - p[:, 1], np.sqrt(2) * np.exp(p[:, 4])
        c1, s1, c2, s2 = np.cos(p[:, 2]), np.sin(p[:, 2]), np.cos(p[:, 3]), np.sin(p[:, 3])
        d1: Array = (c1 * x + s1 * y) / width
        d2: Array = (c2 * x + s2 * y) / width
        e1, e2 = erf(d1), erf(d2)
        steepest = 2 / np.sqrt(np.pi) * p[:, 8]
        by_d1, by_d2 = steepest * e2 * np.exp(-(d1**2)), steepest * e1 * np.exp(-(d2**2))
        derivatives = np.empty((len(p), PARAMETERS, x.shape[1]))
        derivatives[:, 0] = -(by_d1 * c1 + by_d2 * c2) / width - p[:, 6]
        derivatives[:, 1] = -(by_d1 * s1 + by_d2 * s2) / width - p[:, 7]
        derivatives[:, 2] = by_d1 * (c1 * y - s1 * x) / width
        derivatives[:, 3] = by_d2 * (c2 * y - s2 * x) / width
        derivatives[:, 4] = -(by_d1 * d1 + by_d2 * d2)
        derivatives[:, 5], derivatives[:, 6], derivatives[:, 7] = 1.0, x, y
        derivatives[:, 8] = e1 * e2
        values = p[:, 5] + p[:, 6] * x + p[:, 7] * y + p[:, 8] * derivatives[:, 8]
        return values, derivatives


def fit_saddles(windows: Windows, start: Saddles) -> tuple[Saddles, Array]:
    """Fit all corners at once by Levenberg–Marquardt, each with its own damping.

    Return the corners and the RMS (n,) of the residual grey values.
    """
    windows = _drop_unused(windows)
    current, damping = start, np.full(len(start.parameters), 1e-3)
    values, derivatives = current.linearise(windows)
    cost = _compute_cost(windows, values)
    for _ in range(MAX_STEPS):
        hessian, gradient = _form_normal_equations(windows, values, derivatives)
        scale = np.maximum(np.einsum("nii->ni", hessian), 1e-12)
        damped = hessian + (damping[:, None] * scale)[:, :, None] * np.eye(PARAMETERS)
        step = np.asarray(np.linalg.solve(damped, gradient[..., None]), np.float64)[..., 0]
        candidate = Saddles(_clip_blur(current.parameters + step))
        candidate_values, candidate_derivatives = candidate.linearise(windows)
        candidate_cost = _compute_cost(windows, candidate_values)
        better = candidate_cost <= cost
        current = Saddles(np.where(better[:, None], candidate.parameters, current.parameters))
        values = np.where(better[:, None], candidate_values, values)
        derivatives[better] = candidate_derivatives[better]
        cost = np.where(better, candidate_cost, cost)
        damping = np.clip(np.where(better, damping / 5, damping * 5), 1e-9, 1e6)
        if np.abs(step[:, :2]).max(initial=0.0) < CONVERGED_PX:
            break
    return current, np.sqrt(cost / np.maximum(windows.used.sum(axis=1) - PARAMETERS, 1))


def _drop_unused(windows: Windows) -> Windows:
    """Return windows of as many pixels as the fullest one uses, its used ones first: about half of a square."""
    most = int(windows.used.sum(axis=1).max(initial=0.0))
    first = np.argsort(windows.used == 0, axis=1, kind="stable")[:, :most]
    parts = (windows.x, windows.y, windows.values, windows.used)
    return Windows(*(np.take_along_axis(part, first, axis=1) for part in parts))


def _clip_blur(parameters: Array) -> Array:
    low, high = np.log(BLUR_PX)
    return np.concatenate(
        [parameters[:, :4], np.clip(parameters[:, 4:5], low, high), parameters[:, 5:]], axis=1
    )


def _compute_cost(windows: Windows, values: Array) -> Array:
    return np.einsum("nm,nm->n", windows.used, (windows.values - values) ** 2)


def _form_normal_equations(windows: Windows, values: Array, derivatives: Array) -> tuple[Array, Array]:
    """Return the normal equations (n, 9, 9) and (n, 9)."""
    weighted = derivatives * windows.used[:, None]
    hessian = weighted @ derivatives.transpose(0, 2, 1)
    return hessian, (weighted @ (windows.values - values)[..., None])[..., 0]
