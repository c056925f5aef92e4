"""The surface on the core's grid: inverse depth and its slopes, its depth steps, and its visibility.

The planes (H, W) of that grid have NaN where there is nothing. An auxiliary sees a point of the surface that projects
into its image with nothing in front of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels

STEP_PX = 2.5
"""Range of s within 5 × 5 pixels above which there may be a depth step."""
OCCLUDER_PX = 2.0
"""Distance (px of disparity) by which an occluder lies in front of a pixel: more than a slope accounts for."""
_RADIUS, _SIGMA, _TOLERANCE = 3, 2.0, 2.0
"""Window and tolerance (px) of the fit of slopes."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Inverse depth s of every pixel with its slopes; NaN where there is none."""

    s: NDArray[np.float32]
    """(H, W) inverse depth, px of the grid."""
    slope_u: NDArray[np.float32]
    """(H, W) derivative of s along u, per pixel."""
    slope_v: NDArray[np.float32]
    """(H, W) derivative of s along v, per pixel."""

    def replace_where(self, mask: NDArray[np.bool_], other: Surface) -> Surface:
        """Return the other surface inside the mask (H, W) and this one outside."""
        return Surface(
            np.where(mask, other.s, self.s),
            np.where(mask, other.slope_u, self.slope_u),
            np.where(mask, other.slope_v, self.slope_v),
        )


def fill_nan(plane: NDArray[np.floating], value: float = 0.0) -> NDArray[np.float32]:
    """Return a copy with ``value`` in place of NaN; about ten times faster than `numpy.nan_to_num`."""
    filled = np.array(plane, np.float32, order="C")
    cv2.patchNaNs(filled, value)
    return filled


def enlarge_blocks(small: NDArray[np.floating], factor: int, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return (H, W) every value repeated over its block; the last row and column extend to the edge of ``shape``."""
    height, width = (size * factor for size in small.shape)
    full = cv2.resize(np.asarray(small, np.float32), (width, height), interpolation=cv2.INTER_NEAREST)
    missing = shape[0] - height, shape[1] - width
    return np.asarray(
        cv2.copyMakeBorder(full, 0, missing[0], 0, missing[1], cv2.BORDER_REPLICATE), np.float32
    )


def detect_depth_steps(s: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Return the mask (H, W) of pixels around which s ranges over more than `STEP_PX` within 5 × 5 pixels.

    NaN counts as 0.
    """
    s, window = fill_nan(s), np.ones((5, 5), np.uint8)
    span = cv2.dilate(s, window)
    span -= cv2.erode(s, window)
    return span > STEP_PX


def upsample_surface(surface: Surface, step: int) -> NDArray[np.float32]:
    """Return (step · H, step · W) s, in units of the coarse grid, by continuing every pixel's plane over its block.

    Nothing is interpolated between blocks, so depth steps stay sharp.
    """
    if step == 1:
        return surface.s
    offsets = ((np.arange(step) - (step - 1) / 2) / step).astype(np.float32)
    height, width = surface.s.shape
    fine = np.empty((height * step, width * step), np.float32)
    for column, du in enumerate(offsets):
        s_at_column = surface.s + surface.slope_u * du
        for row, dv in enumerate(offsets):
            fine[row::step, column::step] = s_at_column + surface.slope_v * dv
    return fine


def double_surface(surface: Surface, shape: tuple[int, ...]) -> Surface:
    """Return the surface on the grid (H, W) of twice the resolution, with s in pixels of that grid."""
    return Surface(
        enlarge_blocks(2 * upsample_surface(surface, 2), 1, shape),
        enlarge_blocks(surface.slope_u, 2, shape),
        enlarge_blocks(surface.slope_v, 2, shape),
    )


def fit_slopes(s: NDArray[np.float32], kernels: Kernels, threads: int) -> Surface:
    """Return the surface through s with slopes fitted to the neighbours of similar s."""
    fit = kernels.local_fit(
        np.ones_like(s), none := np.zeros_like(s), s, none, none, radii=((_RADIUS, _SIGMA),), tolerance=_TOLERANCE,
        prior_information=0.0, threads=threads,
    )  # fmt: skip
    return Surface(s, fit.slope_u, fit.slope_v)


def compute_visibility(
    s: NDArray[np.floating],
    views: NDArray[np.float32],
    sizes: Sequence[tuple[int, int]],
    kernels: Kernels,
    threads: int = 0,
) -> tuple[NDArray[np.uint8], list[NDArray[np.floating]]]:
    """Return (H, W) the number of auxiliaries that see s (H, W), and each auxiliary's inverse-depth buffer (h, w).

    ``views`` (n, 39) are the auxiliaries' packed projections, ``sizes`` their images' (width, height).
    """
    buffers = kernels.inverse_depth_buffers(s, views, sizes, threads=threads)
    count = np.zeros(s.shape, np.uint8)
    for view, buffer in zip(views, buffers, strict=True):
        count += kernels.visible(s, view, buffer, OCCLUDER_PX, threads=threads)
    return count, list(buffers)
