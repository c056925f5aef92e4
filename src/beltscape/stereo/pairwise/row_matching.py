"""Matches of points of a rectified pair, searched over columns and rows."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.correlation_peak import refine_peak

HALF_PX = 8
"""Half the side of a patch."""
_CORRELATION = 0.65
"""Least correlation of a match."""


def match_rows(
    core: NDArray[np.uint8],
    auxiliary: NDArray[np.uint8],
    corners: NDArray[np.int64],
    disparities: int,
    radius_rows: int,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return (N, 2) disparity and row offset, px, of points (N, 2) of the core, and the mask of searched ones.

    NaN where there is no match, or an ambiguous one.
    """
    matches, inside = np.full((len(corners), 2), np.nan), np.zeros(len(corners), np.bool_)
    for i, (u, v) in enumerate(corners):
        left, top = u - HALF_PX - disparities, v - HALF_PX - radius_rows
        right, bottom = u + HALF_PX + 1, v + HALF_PX + radius_rows + 1
        if left < 0 or top < 0 or right > core.shape[1] or bottom > core.shape[0]:
            continue
        inside[i] = True
        patch = core[v - HALF_PX : v + HALF_PX + 1, u - HALF_PX : u + HALF_PX + 1]
        peak = refine_peak(
            cv2.matchTemplate(auxiliary[top:bottom, left:right], patch, cv2.TM_CCOEFF_NORMED), _CORRELATION
        )
        if peak is not None:
            matches[i] = disparities - peak[0], peak[1] - radius_rows
    return matches, inside
