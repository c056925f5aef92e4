"""Coarse matching: pixels whose plane is reliable in a sweep, and the range of s in which they lie."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.initialisation.plane_sweep import sweep_planes
from beltscape.stereo.multiview.optimisation.least_squares import form_normal_equations

_LEAST_MARGIN = 0.1
"""Margin of the aggregated dissimilarity from which on a plane is reliable."""
_WINDOW_PX = 3
"""Radius of the window in which a match is examined, px of the small images."""
_MISFIT_VARIANCE = 0.2
"""Model variance of normalised levels for a surface that lies between two planes."""
_PATCH_PX, _PATCH_STEP = 60, 3
"""Smallest patch, in pixels, that is kept, and the difference in planes at which a patch ends."""
_ENDS = (0.0005, 0.9995)
"""Quantiles of the matched s that bound the range: the rest are stray matches."""
_MARGIN = (0.06, 0.03)
"""Margin in front of and behind the matches, as a share of the depth, for small tall objects that are missed."""
_ENOUGH_PX = 200
"""Number of matches below which they give no range."""


def find_reliable_matches(
    prepared: PreparedFrame, s_range: tuple[float, float], plane_step: float
) -> NDArray[np.float32]:
    """Return (N,) inverse depth s of the pixels that match reliably among planes ``plane_step`` apart.

    Their plane is best by a margin, an auxiliary agrees with it in least squares too, and they form patches.
    """
    s, margin = sweep_planes(prepared, s_range, plane_step)
    reliable = (margin >= _LEAST_MARGIN) & _mask_agreeing(s, prepared)
    if reliable.any():
        reliable &= _mask_overlap(float(np.median(s[reliable])), prepared)
    return s[_mask_patches((s - s_range[0]) / plane_step, reliable)]


def compute_robust_range(s: NDArray[np.float32]) -> tuple[float, float] | None:
    """Return the (far, near) range of s (N,) with margins; None when there are too few values."""
    if len(s) < _ENOUGH_PX:
        return None
    far, near = np.quantile(s, _ENDS)
    return float(far) / (1 + _MARGIN[1]), float(near) / (1 - _MARGIN[0])


def _mask_agreeing(s: NDArray[np.float32], prepared: PreparedFrame) -> NDArray[np.bool_]:
    """Return the mask (H, W) of pixels at which at least one auxiliary matches the core."""
    _, _, used = form_normal_equations(s, prepared, _WINDOW_PX, _MISFIT_VARIANCE)
    return used > 0


def _mask_overlap(s: float, prepared: PreparedFrame) -> NDArray[np.bool_]:
    """Return the mask (H, W) of pixels that some auxiliary sees at inverse depth s.

    Outside it a wrong plane is best because the right one projects outside the images.
    """
    context = prepared.context
    plane = np.full(prepared.core.shape, s, np.float32)
    inside = [
        context.kernels.visible(plane, view, np.zeros_like(image), 0.0, threads=context.threads)
        for view, image in zip(prepared.views, prepared.images, strict=True)
    ]
    return np.any(inside, axis=0)


def _mask_patches(plane: NDArray[np.floating], mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the part of the mask that forms coherent patches of planes (H, W); single pixels match by chance."""
    index = np.where(mask, plane, -1).round().astype(np.int16)
    cv2.filterSpeckles(index, -1, _PATCH_PX, _PATCH_STEP)
    return index >= 0
