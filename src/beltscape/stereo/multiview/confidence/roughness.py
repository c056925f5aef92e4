"""How rough the material is below the matcher's windows: evidence for sigma.

One pixel does not tell. But on rough material windows disagree more often than noise makes them, over a whole stone
and over a patch of stones.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.frame.nan import fill_nan
from beltscape.stereo.multiview.frame.surface import detect_depth_steps
from beltscape.stereo.multiview.frame.windows import scaled_window
from beltscape.stereo.multiview.optimisation.least_squares import RefinementResult

Array = NDArray[np.floating]

_NEAR_PX, _WIDE_PX = (5, 15), (41, 101)
_STEP_PX = 5
"""Within so much of a step nothing counts."""
_TILE_PX = 4
"""What is averaged over wide windows is averaged over tiles before."""
_LEAST_SHARE, _LEAST = 1e-3, 0.01


def roughness_features(refined: RefinementResult, turn: Array, scale: float) -> Iterator[tuple[str, Array]]:
    """Planes (H, W) by name: means over what lies off steps, where a view agrees; windows grow with ``scale``.

    Of how far the fit's windows disagree, of the variance with which they were content, and of ``turn`` (H, W), by
    how much the planes turn (`beltscape.stereo.multiview.confidence.features`). Disagreement is told as a logarithm, as the others are.
    """
    step = cv2.dilate(
        detect_depth_steps(fill_nan(refined.surface.s)).astype(np.uint8),
        np.ones(scaled_window(_STEP_PX, scale), np.uint8),
    )
    counts = ((refined.used > 0) & (step == 0)).astype(np.float32)
    disagreement = counts * fill_nan(refined.disagreement)
    for window_px in _NEAR_PX:
        side = scaled_window(window_px, scale)
        told = _mean(cv2.blur(disagreement, side), cv2.blur(counts, side))
        yield f"disagreement within {window_px}", np.log(told + np.float32(_LEAST))
    variance = 0.5 * np.log(np.clip(fill_nan(refined.variance, 1.0), 1e-8, 4.0))
    tiles = [_tiles(plane, scale) for plane in (counts, disagreement, counts * turn, counts * variance)]
    for window_px in _WIDE_PX:
        share, apart, *others = (cv2.blur(plane, scaled_window(window_px / _TILE_PX, 1)) for plane in tiles)
        means = [np.log(_mean(apart, share) + np.float32(_LEAST)), *(_mean(plane, share) for plane in others)]
        for name, plane in zip(("disagreement", "turn", "log sigma"), means, strict=True):
            yield f"{name} within {window_px}", cv2.resize(plane, counts.shape[::-1])


def _mean(total: Array, share: Array) -> Array:
    return total / np.maximum(share, np.float32(_LEAST_SHARE))


def _tiles(plane: Array, scale: float) -> Array:
    """Means over tiles."""
    side = max(1, int(_TILE_PX * scale))
    height, width = plane.shape
    size = max(1, width // side), max(1, height // side)
    return np.asarray(cv2.resize(plane, size, interpolation=cv2.INTER_AREA), np.float32)
