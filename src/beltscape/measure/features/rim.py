"""What the depth map says of an edge: where its pixels leave the face, to about a pixel."""

from __future__ import annotations

import numpy as np

from beltscape.measure.features.band import Band

REACH_PX, OUTLINE_PX, CREASE_PX = 1.4, 0.2, 0.0
"""The matcher lets a face reach so far beyond an edge; but only so far where it is the outline of something tall,
or where the solid's own side follows (simulated modules)."""
RIM_SIGMA_PX = 0.6
"""How much these two differ from edge to edge."""
_TALL_MM = 20.0
_ON_MM = 0.35
_LEAST = 30
"""Pixels on either side that a rim needs."""
_SEARCH_PX = 8.0
_STEP_PX = 0.1


def rim_px(band: Band, scale: float = 1.0) -> float | None:
    """Offset that parts pixels on the face from others best, less what the matcher adds; None without both.

    ``scale`` is how much larger the matcher's windows are than those of the paper's images, halved.
    """
    across, off = band.across_px[band.clear], band.off_mm[band.clear]
    on = np.abs(off) < max(_ON_MM, 0.3 * band.px_mm)  # NaN is not on the face
    if min(on.sum(), (~on).sum()) < _LEAST:
        return None
    inside, outside = np.sort(across[on]), np.sort(across[~on])
    tries = np.arange(-_SEARCH_PX, _SEARCH_PX + _STEP_PX / 2, _STEP_PX)
    mistaken = len(inside) - np.searchsorted(inside, tries) + np.searchsorted(outside, tries)
    best = np.nonzero(mistaken == mistaken.min())[0]
    if best[0] == 0 or best[-1] == len(tries) - 1:  # on one side only: no rim
        return None
    beyond = off[(across > 2) & (across < 6)]
    tall = bool(np.isfinite(beyond).any()) and float(np.nanmedian(beyond)) > _TALL_MM
    reach = OUTLINE_PX if tall and band.kind == "outline" else REACH_PX
    if band.kind == "crease":
        reach = CREASE_PX
    if band.kind == "round":
        reach = (OUTLINE_PX + CREASE_PX) / 2
    return float(tries[best].mean()) - reach * scale
