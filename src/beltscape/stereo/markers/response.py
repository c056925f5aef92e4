"""Response of the marker detector per pixel: to red among gold in colour images, to flat among dots in grey ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import Image, to_grey

_RED_LIMIT = 0.5
"""Green over red relative to the dots, below which a pixel is red: half way between red (0) and gold (1)."""
_NOISE_COUNTS = 1.5
"""8-bit counts above the surroundings that exceed noise in a mean of 5×5 pixels."""
_RED_SHARE = 0.01
"""Least level, as a share of the brightest; a belt of black rubber beside a white module has 5 %."""
_FLAT_SHARE = 0.15
"""Least level in a grey image, as a share of the dots' brightness: red light beside gold has more."""
_DOT_DENSITY = 7.3
"""Number of dots on an area of one squared radius of a marker: 25,000 on 1920×1200 px, radius 26 px."""
_MIN_DOT_SHARE = 0.3
"""Least share of the dots that are peaks: some are in shadow, and close ones form one peak."""
_MAX_INSIDE_SHARE = 0.2
"""Largest density of peaks inside a marker over that around it; noise and fine gravel have peaks inside too."""
_DOT_WINDOW = 0.12
"""Half the edge of the window in which a dot is the maximum, in radii of a marker; dots have a radius of 0.1."""
_RING = (1.3, 2.2)
"""Inner and outer radius of the ring that is searched for dots, in radii of the marker."""
_REDUCED = 4
"""Factor by which the image is reduced for the estimation of the background."""


@dataclass(frozen=True, slots=True, eq=False)
class MarkerResponse:
    """Response of the detector at every pixel of an image."""

    mask: NDArray[np.bool_]
    """(H, W) bool: possibly inside a marker."""
    strength: NDArray[np.float32]
    """(H, W) float32, counts: 0 outside, a plateau inside, half of it on the edge."""
    dot_score: Callable[[float, float, float], float]
    """u, v, radius (px) → density of dots on the ring around a disc: 0 without dots, at least 1 with most of them."""


def compute_red_response(image: Image, largest_px: float) -> MarkerResponse:
    """Return the response to red light among gold in an RGB image (H, W, 3).

    ``largest_px`` bounds the radius of a marker. Ambient light, the lower envelope of each channel, is subtracted.
    In the remaining light of the projector, green over red depends on neither exposure nor reflectance; white
    balance and the colour of the material cancel against the dots nearby.
    """
    unit = np.float32(255.0 / np.iinfo(image.dtype).max)
    red, green = (cv2.boxFilter(image[..., c].astype(np.float32) * unit, -1, (5, 5)) for c in (0, 1))
    envelope = int(np.ceil(2.5 * largest_px))
    red, green = (np.maximum(plane - _lower_envelope(plane, envelope), 0) for plane in (red, green))
    gold = _RED_LIMIT * _local_ratio(green, red, 8 * largest_px)
    floor = max(_NOISE_COUNTS, _RED_SHARE * float(np.quantile(red[::4, ::4], 0.999)))
    if image.dtype == np.uint16:  # often 12 bits stored in 16, so the noise in counts is unknown
        floor = _RED_SHARE * float(np.quantile(red[::4, ::4], 0.999))
    strength = np.maximum(red - green / np.maximum(gold, np.float32(1e-6)), 0)
    return MarkerResponse(
        mask=(strength > 0.5 * floor) & (red > floor), strength=strength, dot_score=_full_score
    )


def smooth_counts(image: Image) -> NDArray[np.float32]:
    """Return a grey image (H, W) in 8-bit counts, float32, smoothed by less than a pixel against noise."""
    unit = np.float32(255.0 / np.iinfo(image.dtype).max)
    return np.asarray(cv2.GaussianBlur(to_grey(image) * unit, (0, 0), 0.7), np.float32)


def compute_flat_response(counts: NDArray[np.float32], radius_px: float) -> MarkerResponse:
    """Return the response to bright discs of about ``radius_px`` without texture in smoothed counts (H, W).

    A morphological opening with a window larger than a dot and smaller than a marker removes the dots and leaves
    the markers; the lower envelope over a window larger than a marker is the background. Arrays are computed in
    place, since a fresh one of a whole image costs more than its computation.
    """
    background = _lower_envelope(counts, int(np.ceil(2.5 * radius_px)))
    window = np.ones(
        (2 * max(1, round(0.375 * radius_px)) + 1,) * 2, np.uint8
    )  # odd, since an even window shifts the image
    strength = np.asarray(cv2.dilate(cv2.erode(counts, window), window), np.float32)
    strength -= background
    np.maximum(strength, 0, out=strength)
    dots = np.asarray(cv2.dilate(counts, window), np.float32)
    dots -= background
    dots *= np.float32(_FLAT_SHARE)
    mask = strength > np.maximum(dots, np.float32(_NOISE_COUNTS), out=dots)
    fine = np.ones((2 * max(1, round(_DOT_WINDOW * radius_px)) + 1,) * 2, np.uint8)
    highest = np.asarray(cv2.dilate(counts, fine), np.float32)
    peak = np.asarray(cv2.erode(counts, fine), np.float32)
    np.subtract(highest, peak, out=peak)
    np.multiply(peak, counts == highest, out=peak)

    def dot_score(u: float, v: float, radius: float) -> float:
        return _score_dots(peak, strength, u, v, radius)

    return MarkerResponse(mask, strength, dot_score)


def _score_dots(
    peak: NDArray[np.float32], strength: NDArray[np.float32], u: float, v: float, radius: float
) -> float:
    """Return the number of dots on the ring around a disc over half of the expected one; 0 where they are too few.

    A dot is a local maximum at least half as high as the disc, since red is not brighter than gold. Stones without
    a pattern have edges, but not about thirty peaks on a ring.
    """
    reach = int(np.ceil(_RING[1] * radius))
    y0, x0 = max(int(v) - reach, 0), max(int(u) - reach, 0)
    near = (slice(y0, int(v) + reach + 1), slice(x0, int(u) + reach + 1))
    rows, columns = (np.arange(n, dtype=np.float64) for n in peak[near].shape)
    distance = np.hypot(columns + x0 - u, (rows + y0 - v)[:, None])
    ring = (distance > _RING[0] * radius) & (distance < _RING[1] * radius)
    inside = distance < 0.6 * radius
    if not ring.any() or not inside.any():
        return 0.0
    level = float(np.median(strength[near][inside]))
    is_dot = peak[near] > 0.5 * level
    around, within = (np.count_nonzero(is_dot & part) / np.count_nonzero(part) for part in (ring, inside))
    share = around * radius**2 / _DOT_DENSITY
    return 2 * share if share > _MIN_DOT_SHARE and within < _MAX_INSIDE_SHARE * around else 0.0


def _full_score(u: float, v: float, radius: float) -> float:
    """Return 1: red discs need no dots around them."""
    del u, v, radius
    return 1.0


def _lower_envelope(plane: NDArray[np.float32], window_px: int) -> NDArray[np.float32]:
    """Return the (H, W) smoothed minimum within a window: the ambient light in the gaps between dots."""
    height, width = plane.shape
    low = cv2.erode(plane, np.ones((_REDUCED, _REDUCED), np.uint8))[::_REDUCED, ::_REDUCED]
    size = max(1, window_px // _REDUCED)
    low = cv2.boxFilter(cv2.erode(low, np.ones((size, size), np.uint8)), -1, (size, size))
    return np.asarray(cv2.resize(low, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)


def _local_ratio(
    above: NDArray[np.float32], below: NDArray[np.float32], window_px: float
) -> NDArray[np.float32]:
    """Return the (H, W) ratio of two planes averaged over a window; within a factor 2 of the whole image's ratio."""
    height, width = above.shape
    size = max(1, round(window_px / _REDUCED))
    small = (width // _REDUCED, height // _REDUCED)
    a, b = (
        cv2.boxFilter(cv2.resize(p, small, interpolation=cv2.INTER_AREA), -1, (size, size))
        for p in (above, below)
    )
    whole = float(a.sum()) / max(float(b.sum()), 1e-6)
    local = np.clip(a / np.maximum(b, np.float32(1e-3)), whole / 2, whole * 2)
    return np.asarray(cv2.resize(local, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)
