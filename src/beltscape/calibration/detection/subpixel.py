"""Subpixel refinement of detected corners: the crossing of two fitted edges, to a hundredth of a pixel.

The model is a saddle: two crossing blurred edges, fitted to the pixels by least squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from beltscape.calibration.detection.corners import Corners
from beltscape.core.arrays import Array

PARAMETERS = 9
"""Parameters of a corner."""
BLUR_PX = 0.3, 8.0
"""Bounds of the blur: about a pixel's own width, and a blur in which no corner is visible."""
CONVERGED_PX = 5e-4
"""The fit has converged if all corners move by less."""
MAX_STEPS = 10
"""Iterations of the fit at most."""


@dataclass(frozen=True, slots=True, eq=False)
class CornerWindows:
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

    def linearise(self, windows: CornerWindows) -> tuple[Array, Array]:
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


def fit_saddles(windows: CornerWindows, start: Saddles) -> tuple[Saddles, Array]:
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


def _drop_unused(windows: CornerWindows) -> CornerWindows:
    """Return windows of as many pixels as the fullest one uses, its used ones first: about half of a square."""
    most = int(windows.used.sum(axis=1).max(initial=0.0))
    first = np.argsort(windows.used == 0, axis=1, kind="stable")[:, :most]
    parts = (windows.x, windows.y, windows.values, windows.used)
    return CornerWindows(*(np.take_along_axis(part, first, axis=1) for part in parts))


def _clip_blur(parameters: Array) -> Array:
    low, high = np.log(BLUR_PX)
    return np.concatenate(
        [parameters[:, :4], np.clip(parameters[:, 4:5], low, high), parameters[:, 5:]], axis=1
    )


def _compute_cost(windows: CornerWindows, values: Array) -> Array:
    return np.einsum("nm,nm->n", windows.used, (windows.values - values) ** 2)


def _form_normal_equations(windows: CornerWindows, values: Array, derivatives: Array) -> tuple[Array, Array]:
    """Return the normal equations (n, 9, 9) and (n, 9)."""
    weighted = derivatives * windows.used[:, None]
    hessian = weighted @ derivatives.transpose(0, 2, 1)
    return hessian, (weighted @ (windows.values - values)[..., None])[..., 0]


WINDOW_REACH = 0.7
"""Reach of a window along the edges, in squares; the next corner's edges begin at 1."""
MAX_RADIUS_PX = 12
"""Largest radius of a window."""
MARGIN_BLURS = 2.0
"""Distance of a window, in blurs, from structures outside the model: markers, the next corner's edges."""
START_BLUR_PX = 1.0
"""Start value of the blur."""
MIN_PIXELS = 30
"""Least number of pixels in a window."""
MAX_SHIFT_PX, MAX_SHIFT = 1.5, 0.05
"""A corner that moves by more px, and by a larger share of the square, has converged to another structure."""
MAX_RESIDUAL = 0.25
"""Limit of the RMS residual over the contrast; above it a corner is covered, glaring, or no corner."""


def refine_corners(luminance: NDArray[np.float32], corners: Corners, squares: Array, gap: float) -> Corners:
    """Refine every corner; corners without a pair of crossing edges nearby are dropped.

    Parameters
    ----------
    luminance
        (H, W) linear or not, in any unit.
    corners
        Detected to about a pixel.
    squares
        (n, 2) positions of these corners on the board, in squares.
    gap
        Share of a square beside its edges that is empty: 1 without markers.
    """
    homography, _ = cv2.findHomography(squares, corners.pixels) if len(corners) >= 4 else (None, None)
    if homography is None:
        return corners
    axes = _compute_square_axes(homography, squares)
    start, windows = _initialise(luminance, corners.pixels, axes, gap)
    windows = _mask_windows(windows, axes, gap, start, np.full(len(corners), START_BLUR_PX))
    initial, _ = fit_saddles(windows, start)
    windows = _mask_windows(windows, axes, gap, initial, initial.blur_px)
    saddles, rms = fit_saddles(windows, initial)
    side = np.linalg.norm(axes, axis=1).min(axis=1)
    good = np.linalg.norm(saddles.offset_px, axis=1) < np.maximum(MAX_SHIFT_PX, MAX_SHIFT * side)
    good &= (rms < MAX_RESIDUAL * saddles.contrast) & (windows.used.sum(axis=1) >= MIN_PIXELS)
    return Corners(corners.ids[good], (corners.pixels + saddles.offset_px)[good])


def _compute_square_axes(homography: Array, squares: Array) -> Array:
    """Return pixels per square (n, 2, 2), columns along the board's x and y."""
    mapped = np.column_stack([squares, np.ones(len(squares))]) @ homography.T
    pixels = mapped[:, :2] / mapped[:, 2:]
    return (homography[:2, :2] - pixels[:, :, None] * homography[2, :2]) / mapped[:, 2, None, None]


def _initialise(
    luminance: NDArray[np.float32], pixels: Array, axes: Array, gap: float
) -> tuple[Saddles, CornerWindows]:
    """Return round windows about the corners, and start values of their edges from the board's pose."""
    sides = np.linalg.norm(axes, axis=1)
    radius = int(np.clip(np.ceil(WINDOW_REACH * sides.max()), 3, MAX_RADIUS_PX))
    grid = np.arange(-radius, radius + 1)
    dx, dy = (d.ravel() for d in np.meshgrid(grid, grid))
    nearest = np.rint(pixels).astype(int)
    u, v = nearest[:, :1] + dx, nearest[:, 1:] + dy
    height, width = luminance.shape
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height) & (dx**2 + dy**2 <= (radius + 0.5) ** 2)
    values = luminance[v.clip(0, height - 1), u.clip(0, width - 1)].astype(np.float64)
    windows = CornerWindows(u - pixels[:, :1], v - pixels[:, 1:], values, inside.astype(np.float64))
    across, down = _map_to_board(windows, axes)
    near = windows.used * (np.maximum(np.abs(across), np.abs(down)) < min(gap, 0.5))
    even, odd = (_average(values, near * (sign * across * down > 0)) for sign in (1, -1))
    normals = [_compute_normals(axes[:, :, 0], axes[:, :, 1]), _compute_normals(axes[:, :, 1], axes[:, :, 0])]
    parameters = np.zeros((len(pixels), PARAMETERS))
    parameters[:, 2:4] = np.stack([np.arctan2(n[:, 1], n[:, 0]) for n in normals], axis=1)
    parameters[:, 4] = np.log(START_BLUR_PX)
    parameters[:, 5], parameters[:, 8] = (even + odd) / 2, (even - odd) / 2
    return Saddles(parameters), windows


def _mask_windows(
    windows: CornerWindows, axes: Array, gap: float, saddles: Saddles, blur_px: Array
) -> CornerWindows:
    """Restrict windows to pixels that only the two edges affect: away from the markers in light squares."""
    across, down = (np.abs(a) for a in _map_to_board(windows, axes))
    margin = MARGIN_BLURS * blur_px[:, None] / np.linalg.norm(axes, axis=1)  # in squares
    reach = np.minimum(WINDOW_REACH, 1 - margin)
    used = windows.used * ((across < reach[:, :1]) & (down < reach[:, 1:]))
    marker = (across > gap - margin[:, :1]) & (down > gap - margin[:, 1:])
    signs = np.multiply(*_map_to_board(windows, axes)) * saddles.parameters[:, 8:]
    return CornerWindows(windows.x, windows.y, windows.values, used * ~(marker & (signs > 0)))


def _map_to_board(windows: CornerWindows, axes: Array) -> tuple[Array, Array]:
    """Return the pixels' offsets (n, m) from the corner in squares, along the board's x and y."""
    inverse = np.linalg.inv(axes)
    across = inverse[:, 0, :1] * windows.x + inverse[:, 0, 1:] * windows.y
    down = inverse[:, 1, :1] * windows.x + inverse[:, 1, 1:] * windows.y
    return across, down


def _compute_normals(along: Array, towards: Array) -> Array:
    """Return unnormalised normals (n, 2) of the first, on the side of the second."""
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    return normal * np.sign((normal * towards).sum(axis=1, keepdims=True))


def _average(values: Array, weights: Array) -> Array:
    return (values * weights).sum(axis=1) / np.maximum(weights.sum(axis=1), 1)
