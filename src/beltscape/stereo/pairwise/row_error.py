"""Row offsets of corresponding points in a rectified pair, measured on its images."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.statistics import MAD_TO_SIGMA, MEDIAN_TO_MEAN_SIGMA
from beltscape.stereo.correlation_peak import refine_peak

HALF_PX = 8
"""Half the side of a patch."""
SEARCH_RADII_ROWS = (6, 24)
"""Rows searched above and below; the larger radius is used where the smaller one finds too few matches."""
MIN_MATCHES = 10
"""Least number of matches of a measurement."""
_CORRELATION = 0.65
"""Least correlation of a match."""
_MAX_CORNERS = 400
"""Largest number of corners that are searched."""


@dataclass(frozen=True, slots=True)
class RowError:
    """Statistics of the row offsets of matches in a rectified pair."""

    points: int
    """Number of matches."""
    searched: int
    """Number of textured points of the core that were searched."""
    median_px: float
    """Median offset (auxiliary minus core), caused by a rotated or shifted camera."""
    rms_px: float
    """Robust RMS (1.4826·MAD about 0) of the offset, with its change over the image."""
    sigma_px: float
    """One standard deviation of the median."""

    @property
    def is_measured(self) -> bool:
        """True if there are enough matches to measure the offset."""
        return self.points >= MIN_MATCHES


def measure_row_error(core: NDArray[np.uint8], auxiliary: NDArray[np.uint8], disparities: int) -> RowError:
    """Return the row error of textured patches between two rectified images (H, W) uint8; NaN for too few matches.

    The patches are matched by normalised correlation, with subpixel peaks, over ``disparities`` columns to the left
    and the rows of `SEARCH_RADII_ROWS` up and down.
    """
    detected = cv2.goodFeaturesToTrack(
        core, maxCorners=_MAX_CORNERS, qualityLevel=0.02, minDistance=2 * HALF_PX
    )
    corners = np.empty((0, 2), np.int64) if detected is None else np.rint(detected[:, 0]).astype(np.int64)
    rows, searched = np.empty(0), 0
    for radius in SEARCH_RADII_ROWS:
        matches, inside = match_rows(core, auxiliary, corners, disparities, radius)
        rows, searched = matches[np.isfinite(matches[:, 1]), 1], int(inside.sum())
        if len(rows) >= max(MIN_MATCHES, 0.3 * searched):
            break
    if len(rows) < MIN_MATCHES:
        return RowError(len(rows), searched, np.nan, np.nan, np.nan)
    median = float(np.median(rows))
    scatter = MAD_TO_SIGMA * float(np.median(np.abs(rows - median)))
    rms = MAD_TO_SIGMA * float(np.median(np.abs(rows)))
    return RowError(
        len(rows), searched, median, rms, MEDIAN_TO_MEAN_SIGMA * scatter / float(np.sqrt(len(rows)))
    )


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
