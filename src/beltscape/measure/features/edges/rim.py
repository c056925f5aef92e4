"""The rim of the measured depth at an edge: where its pixels leave the face, to about a pixel."""

from __future__ import annotations

import numpy as np

from beltscape.measure.features.edges.band import Band

LOW_PX, OUTLINE_PX, CREASE_PX = 0.4, -0.1, 0.2
"""Bias of the rim beyond a low edge, the outline of something tall, and an edge with the solid's own side below it:
between ``standard`` (0.0, −0.2, 0.05) and ``fast`` (0.8, 0.1, 0.45) on simulated modules at 1224 and 612 px. The bias
depends on the surfaces: a base as dark as the belt has −1.0 px."""
RIM_SIGMA_PX = 0.9
"""Standard deviation of this bias over edges and presets (largest deviation: 1.75 px)."""
_TALL_MM = 20.0
"""Height of an edge over what lies beside it from which it is the outline of something tall."""
_ON_MM = 0.35
"""Pixels within this distance of the fitted face belong to it."""
_MIN_PIXELS = 30
"""Least number of pixels on either side of a rim."""
_SEARCH_PX = 8.0
"""Half of the range that is searched; the rim lies within the matcher's reach."""
_STEP_PX = 0.1
"""Step of the search; far below σ of the rim."""


def locate_rim_px(band: Band) -> float | None:
    """Return the offset that best separates pixels on the face from others, less the matcher's bias, or None."""
    across, off = band.across_px[band.clear], band.off_mm[band.clear]
    on = np.abs(off) < max(_ON_MM, 0.3 * band.px_mm)  # NaN is not on the face
    if min(on.sum(), (~on).sum()) < _MIN_PIXELS:
        return None
    inside, outside = np.sort(across[on]), np.sort(across[~on])
    tries = np.arange(-_SEARCH_PX, _SEARCH_PX + _STEP_PX / 2, _STEP_PX)
    misclassified = len(inside) - np.searchsorted(inside, tries) + np.searchsorted(outside, tries)
    best = np.nonzero(misclassified == misclassified.min())[0]
    if best[0] == 0 or best[-1] == len(tries) - 1:  # on one side only: no rim
        return None
    beyond = off[(across > 2) & (across < 6)]
    tall = bool(np.isfinite(beyond).any()) and float(np.nanmedian(beyond)) > _TALL_MM
    bias = OUTLINE_PX if tall and band.kind == "outline" else LOW_PX
    if band.kind == "crease":
        bias = CREASE_PX
    if band.kind == "round":
        bias = (OUTLINE_PX + CREASE_PX) / 2
    return float(tries[best].mean()) - bias
