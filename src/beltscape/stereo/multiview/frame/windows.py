"""How large the matcher's windows are: they grow with the images, as the pattern's dots do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Radii = tuple[tuple[int, float], ...]
"""Windows of a fit: (radius px, Gaussian sigma px), smallest first."""

_WIDTH_PX = 1224
"""The grid for which the sizes below are told."""
_SCALE = (0.5, 1.8)
_NARROW_PX, _FIRM_PX, _WIDE_PX = (1.5, 2.5), (4.0,), (2.5, 5.0)
_RADIUS = 2.0
"""Of a window, in its Gaussian's sigmas."""
_LEVELS_PX = 7
MOST_PX = 15
"""The largest radius the kernels take."""


@dataclass(frozen=True, slots=True)
class Windows:
    """For one width of the grid."""

    narrow: Radii
    """Of the fits between rounds of propagation."""
    firm: Radii
    """Of the last fits but one, and of sharpening."""
    wide: Radii
    """Of the last fit."""
    levels_px: int
    """Radius of the window in which levels are normalised."""
    scale: float
    """Of distances in px, 1 for images as wide as the paper's, halved."""


def windows_for(width_px: int) -> Windows:
    """Windows for a grid of this width."""
    scale = float(np.clip(width_px / _WIDTH_PX, *_SCALE))
    radii = (_radii(sigmas_px, scale) for sigmas_px in (_NARROW_PX, _FIRM_PX, _WIDE_PX))
    return Windows(*radii, max(3, round(_LEVELS_PX * scale)), scale)


def scaled_window(window_px: float, scale: float) -> tuple[int, int]:
    """An odd window on a grid ``scale`` times finer than the one it is told for."""
    side = 2 * int(window_px * scale / 2) + 1
    return side, side


def _radii(sigmas_px: tuple[float, ...], scale: float) -> Radii:
    """A window larger than the kernels take is cut."""
    return tuple((min(MOST_PX, int(np.ceil(_RADIUS * sigma * scale))), sigma * scale) for sigma in sigmas_px)
