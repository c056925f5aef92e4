"""Window sizes of the matcher; they grow with the images, as the pattern's dots do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

Radii = tuple[tuple[int, float], ...]
"""Windows of a fit: (radius px, Gaussian sigma px), smallest first."""

_WIDTH_PX = 1224
"""Width of the grid to which the sizes below apply (scale 1)."""
_SCALE = (0.5, 1.8)
"""Range of the scale; MOST_PX limits the largest windows."""
_NARROW_PX, _FIRM_PX, _WIDE_PX = (1.5, 2.5), (4.0,), (2.5, 5.0)
"""Gaussian σ of the windows of least squares at scale 1: between rounds, twicing, last iteration."""
_RADIUS = 2.0
"""Radius of a window in sigmas of its Gaussian."""
_LEVELS_PX = 7
"""Radius of the window in which levels are normalised, at scale 1."""
MOST_PX = 15
"""Largest radius that the kernels accept."""
_BOXES_PX = (3, 5, 7, 9, 11, 15, 21, 25, 31)
"""Sides, at scale 1, of the square windows over which values are averaged or compared."""


@dataclass(frozen=True, slots=True)
class Windows:
    """Window sizes for one width of the grid."""

    narrow: Radii
    """Of the fits between rounds of propagation."""
    firm: Radii
    """Of twicing's fit."""
    wide: Radii
    """Of the last fit."""
    levels_px: int
    """Radius of the window in which levels are normalised."""
    boxes: Mapping[int, tuple[int, int]]
    """Odd (width, height) of square windows on the grid, by their side in px at scale 1."""
    scale: float
    """Factor of all distances in px; 1 on a grid as wide as half the paper's images."""


def choose_windows(width_px: int) -> Windows:
    """Return the window sizes for a grid of this width."""
    scale = float(np.clip(width_px / _WIDTH_PX, *_SCALE))
    narrow, firm, wide = (_choose_radii(sigmas_px, scale) for sigmas_px in (_NARROW_PX, _FIRM_PX, _WIDE_PX))
    return Windows(narrow, firm, wide, max(3, round(_LEVELS_PX * scale)), scale_boxes(scale), scale)


def scale_boxes(scale: float) -> dict[int, tuple[int, int]]:
    """Return the odd (width, height) of square windows on a grid of this scale, by their side in px at scale 1."""
    sides = {side_px: 2 * int(side_px * scale / 2) + 1 for side_px in _BOXES_PX}
    return {side_px: (side, side) for side_px, side in sides.items()}


def _choose_radii(sigmas_px: tuple[float, ...], scale: float) -> Radii:
    """Return radius and sigma of each window; radii are limited to what the kernels accept."""
    return tuple((min(MOST_PX, int(np.ceil(_RADIUS * sigma * scale))), sigma * scale) for sigma in sigmas_px)
