"""A surface on the core's grid: nearness and its slopes, the state the matcher improves."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels

STEP_PX = 2.5
"""A range of s within 5 × 5 pixels from which on it may be a depth step."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Nearness s per pixel with its slopes; NaN where there is none."""

    s: NDArray[np.float32]
    """(H, W) nearness, px of the grid."""
    slope_u: NDArray[np.float32]
    """(H, W) of s per pixel along u."""
    slope_v: NDArray[np.float32]
    """(H, W) of s per pixel along v."""

    def where(self, there: NDArray[np.bool_], other: Surface) -> Surface:
        """Another surface there (H, W), and this one elsewhere."""
        return Surface(
            np.where(there, other.s, self.s),
            np.where(there, other.slope_u, self.slope_u),
            np.where(there, other.slope_v, self.slope_v),
        )


def detect_depth_steps(s: NDArray[np.floating]) -> NDArray[np.bool_]:
    """(H, W) where finite s makes a depth step: it ranges by more than `STEP_PX` within 5 × 5 pixels."""
    window = np.ones((5, 5), np.uint8)
    return cv2.dilate(s, window) - cv2.erode(s, window) > STEP_PX


def upsample_surface(surface: Surface, step: int) -> NDArray[np.float32]:
    """(step · H, step · W) blocks as planes, at their pixels' centres, in the blocks' px: no mixing over steps."""
    if step == 1:
        return surface.s
    inside = ((np.arange(step) - (step - 1) / 2) / step).astype(np.float32)
    height, width = surface.s.shape
    found = np.empty((height * step, width * step), np.float32)
    for across, du in enumerate(inside):
        column = surface.s + surface.slope_u * du
        for down, dv in enumerate(inside):
            found[down::step, across::step] = column + surface.slope_v * dv
    return found


_RADIUS, _SIGMA, _TOLERANCE = 3, 2.0, 2.0


def fit_slopes(s: NDArray[np.float32], kernels: Kernels, threads: int) -> Surface:
    """The surface through s, its slopes fitted over the neighbours that lie about as far."""
    fit = kernels.local_fit(
        np.ones_like(s), none := np.zeros_like(s), s, none, none, radii=((_RADIUS, _SIGMA),), tolerance=_TOLERANCE,
        prior_information=0.0, threads=threads,
    )  # fmt: skip
    return Surface(s, fit.slope_u, fit.slope_v)
