"""Roughness of the material below the size of the matcher's windows, as features for sigma.

A single pixel does not show it. On rough material the windows of the fit disagree more often than noise explains,
over a whole stone and over a region of stones.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.frame.nan import fill_nan
from beltscape.stereo.multiview.frame.surface import detect_depth_steps
from beltscape.stereo.multiview.frame.windows import scale_window
from beltscape.stereo.multiview.optimisation.least_squares import LeastSquaresResult

Array = NDArray[np.floating]

_NEAR_PX, _WIDE_PX = (5, 15), (41, 101)
"""Sides of the windows, at scale 1, of a pixel itself and of its surroundings."""
_STEP_PX = 5
"""Window around a depth step that is left out."""
_TILE_PX = 4
"""Side of the tiles that are averaged before the wide windows."""
_LEAST_SHARE, _LEAST = 1e-3, 0.01
"""Least share of measured pixels, and the offset before the logarithm, against division by and logarithm of zero."""


def compute_roughness_features(
    solution: LeastSquaresResult, slope_deviation: Array, scale: float
) -> Iterator[tuple[str, Array]]:
    """Yield means (H, W) by name over the pixels away from depth steps at which a view agrees.

    They are the logarithm of the disagreement of the fit's windows, ``slope_deviation`` (H, W) of
    `features.compute_shape_features`, and the logarithm of sigma. Windows grow with ``scale``.
    """
    step = cv2.dilate(
        detect_depth_steps(fill_nan(solution.surface.s)).astype(np.uint8),
        np.ones(scale_window(_STEP_PX, scale), np.uint8),
    )
    used = ((solution.used > 0) & (step == 0)).astype(np.float32)
    disagreement = used * fill_nan(solution.disagreement)
    for window_px in _NEAR_PX:
        side = scale_window(window_px, scale)
        mean = _compute_mean(cv2.blur(disagreement, side), cv2.blur(used, side))
        yield f"window disagreement within {window_px}", np.log(mean + np.float32(_LEAST))
    log_sigma = 0.5 * np.log(np.clip(fill_nan(solution.variance, 1.0), 1e-8, 4.0))
    tiles = [
        _average_tiles(plane, scale)
        for plane in (used, disagreement, used * slope_deviation, used * log_sigma)
    ]
    for window_px in _WIDE_PX:
        share, total, *others = (cv2.blur(plane, scale_window(window_px / _TILE_PX, 1)) for plane in tiles)
        means = [
            np.log(_compute_mean(total, share) + np.float32(_LEAST)),
            *(_compute_mean(plane, share) for plane in others),
        ]
        names = "window disagreement", "slope deviation", "log sigma"
        for name, plane in zip(names, means, strict=True):
            yield f"{name} within {window_px}", cv2.resize(plane, used.shape[::-1])


def _compute_mean(total: Array, share: Array) -> Array:
    return total / np.maximum(share, np.float32(_LEAST_SHARE))


def _average_tiles(plane: Array, scale: float) -> Array:
    """Return means over tiles."""
    side = max(1, int(_TILE_PX * scale))
    height, width = plane.shape
    size = max(1, width // side), max(1, height // side)
    return np.asarray(cv2.resize(plane, size, interpolation=cv2.INTER_AREA), np.float32)
