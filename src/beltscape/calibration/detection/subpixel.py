"""Subpixel refinement of detected corners: the crossing of two fitted edges, to a hundredth of a pixel."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.corners import Corners
from beltscape.calibration.detection.saddle import PARAMETERS, Saddles, Windows, fit_saddles

Array = NDArray[np.float64]

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
) -> tuple[Saddles, Windows]:
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
    windows = Windows(u - pixels[:, :1], v - pixels[:, 1:], values, inside.astype(np.float64))
    across, down = _map_to_board(windows, axes)
    near = windows.used * (np.maximum(np.abs(across), np.abs(down)) < min(gap, 0.5))
    even, odd = (_average(values, near * (sign * across * down > 0)) for sign in (1, -1))
    normals = [_compute_normals(axes[:, :, 0], axes[:, :, 1]), _compute_normals(axes[:, :, 1], axes[:, :, 0])]
    parameters = np.zeros((len(pixels), PARAMETERS))
    parameters[:, 2:4] = np.stack([np.arctan2(n[:, 1], n[:, 0]) for n in normals], axis=1)
    parameters[:, 4] = np.log(START_BLUR_PX)
    parameters[:, 5], parameters[:, 8] = (even + odd) / 2, (even - odd) / 2
    return Saddles(parameters), windows


def _mask_windows(windows: Windows, axes: Array, gap: float, saddles: Saddles, blur_px: Array) -> Windows:
    """Restrict windows to pixels that only the two edges affect: away from the markers in light squares."""
    across, down = (np.abs(a) for a in _map_to_board(windows, axes))
    margin = MARGIN_BLURS * blur_px[:, None] / np.linalg.norm(axes, axis=1)  # in squares
    reach = np.minimum(WINDOW_REACH, 1 - margin)
    used = windows.used * ((across < reach[:, :1]) & (down < reach[:, 1:]))
    marker = (across > gap - margin[:, :1]) & (down > gap - margin[:, 1:])
    signs = np.multiply(*_map_to_board(windows, axes)) * saddles.parameters[:, 8:]
    return Windows(windows.x, windows.y, windows.values, used * ~(marker & (signs > 0)))


def _map_to_board(windows: Windows, axes: Array) -> tuple[Array, Array]:
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
