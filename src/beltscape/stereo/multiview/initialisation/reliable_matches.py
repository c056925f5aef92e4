"""A coarse look: which surfaces stand out clearly in a sweep, and between which planes they lie."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import Kernels
from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.initialisation.plane_sweep import sweep_planes
from beltscape.stereo.multiview.optimisation.least_squares import form_normal_equations

_CLEAR = 0.1
"""Margin of the aggregated dissimilarity by which a plane must win to count."""
_WINDOW_PX = 3
_MISFIT_VARIANCE = 0.2
"""Of normalised levels: a surface between two planes agrees as well as that."""
_PATCH_PX, _PATCH_STEP = 60, 3
"""Smaller patches are chance; a patch ends where the plane steps by more."""
_ENDS = (0.0005, 0.9995)
"""Share of the found surface that may lie farther, and nearer: stray matches."""
_MARGIN = (0.06, 0.03)
"""Kept free before and behind what the coarse look saw, as a share of the depth: small tall things it missed."""
_ENOUGH_PX = 200


def find_reliable_matches(
    prepared: PreparedFrame, nearness: tuple[float, float], plane: float, kernels: Kernels, threads: int
) -> NDArray[np.float32]:
    """(N,) nearness s of the pixels whose surface stands out clearly among planes ``plane`` apart.

    They win by a margin, an auxiliary agrees with them by least squares too, and they lie on patches.
    """
    s, margin = sweep_planes(prepared, nearness, plane, kernels, threads)
    agreed = (margin >= _CLEAR) & _agreed(s, prepared, kernels, threads)
    if agreed.any():
        agreed &= _common(float(np.median(s[agreed])), prepared, kernels, threads)
    return s[_on_patches((s - nearness[0]) / plane, agreed)]


def robust_range(surface: NDArray[np.float32]) -> tuple[float, float] | None:
    """(far, near) nearness about the pixels (N,) of a surface, with margins; None when they are too few."""
    if len(surface) < _ENOUGH_PX:
        return None
    far, near = np.quantile(surface, _ENDS)
    return float(far) / (1 + _MARGIN[1]), float(near) / (1 - _MARGIN[0])


def _agreed(
    s: NDArray[np.float32], prepared: PreparedFrame, kernels: Kernels, threads: int
) -> NDArray[np.bool_]:
    """Where an auxiliary sees what the core sees."""
    _, _, used = form_normal_equations(s, prepared, _WINDOW_PX, _MISFIT_VARIANCE, kernels, threads)
    return used > 0


def _common(s: float, prepared: PreparedFrame, kernels: Kernels, threads: int) -> NDArray[np.bool_]:
    """Where an auxiliary looks at nearness s: elsewhere a plane wins because the right one is out of its image."""
    plane = np.full(prepared.core.shape, s, np.float32)
    inside = [
        kernels.visible(plane, view, np.zeros_like(image), 0.0, threads=threads)
        for view, image in zip(prepared.views, prepared.images, strict=True)
    ]
    return np.any(inside, axis=0)


def _on_patches(plane: NDArray[np.floating], where: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Those on a coherent patch of surface; lone ones are chance."""
    whole = np.where(where, plane, -1).round().astype(np.int16)
    cv2.filterSpeckles(whole, -1, _PATCH_PX, _PATCH_STEP)
    return whole >= 0
