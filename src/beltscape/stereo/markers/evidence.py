"""Where an image could show a marker: red among gold in colour, flat among dots in grey."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import Image, to_grey

_RED = 0.5
"""Green over red, in units of the dots' own, below which a pixel is red: half way between red (0) and gold (1)."""
_NOISE_COUNTS = 1.5
"""Counts of 8 bit above the surroundings that are more than noise, once 5×5 pixels are averaged."""
_BRIGHTEST_SHARE = 0.01
"""Of the brightest: a belt of black rubber beside a white module gives 5 %."""
_FLAT_SHARE = 0.15
"""Of the dots' brightness: red light is at least this bright, to a grey camera, beside gold."""
_DOTS = 7.3
"""Dots on an area of one squared radius of a marker: 25,000 on 1920×1200 about radii of 26."""
_FEWEST = 0.3
"""Share of them that is seen at least: some are in shadow, close ones are one peak."""
_INSIDE = 0.2
"""As dense as around, at most, are peaks inside a marker: what has them there too is noise or fine gravel."""
_DOT_WINDOW = 0.12
"""Half the edge of the window in which a dot is the brightest, in radii of a marker; dots have a radius of 0.1."""
_RING = (1.3, 2.2)
"""Where dots are looked for, in radii."""
_REDUCED = 4
"""Backgrounds are found in an image this many times smaller."""


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What speaks for a marker, per pixel."""

    mask: NDArray[np.bool_]
    """(H, W) bool: inside a marker, as far as one pixel can tell."""
    strength: NDArray[np.float32]
    """(H, W) float32, counts: 0 outside, a plateau inside, half of it on the edge."""
    surround: Callable[[float, float, float], float]
    """u, v, radius (px) → how sure the ring about a disc shows dots: 0 no, 1 or more yes."""


def red_evidence(image: Image, largest_px: float) -> Evidence:
    """Red light among gold in an RGB image (H, W, 3); ``largest_px`` bounds the radius of a marker.

    The ambient light is subtracted, as the lower envelope of each channel. What remains is light of the
    projector, in which green over red depends on neither exposure nor how strongly the surface reflects; white
    balance and the colour of the material cancel against the dots nearby.
    """
    unit = np.float32(255.0 / np.iinfo(image.dtype).max)
    red, green = (cv2.boxFilter(image[..., c].astype(np.float32) * unit, -1, (5, 5)) for c in (0, 1))
    envelope = int(np.ceil(2.5 * largest_px))
    red, green = (np.maximum(plane - _lower_envelope(plane, envelope), 0) for plane in (red, green))
    gold = _RED * _local_ratio(green, red, 8 * largest_px)
    floor = max(_NOISE_COUNTS, _BRIGHTEST_SHARE * float(np.quantile(red[::4, ::4], 0.999)))
    if image.dtype == np.uint16:  # 12 bits are often stored in 16: only the scene itself says what is bright
        floor = _BRIGHTEST_SHARE * float(np.quantile(red[::4, ::4], 0.999))
    strength = np.maximum(red - green / np.maximum(gold, np.float32(1e-6)), 0)
    return Evidence(mask=(strength > 0.5 * floor) & (red > floor), strength=strength, surround=_red_is_enough)


def flat_evidence(image: Image, radius_px: float) -> Evidence:
    """Bright without texture over about ``radius_px`` in a grey image (H, W), among texture.

    A morphological opening with a window larger than a dot and smaller than a marker removes the dots and leaves
    the markers; one with a window larger than a marker says what is beneath them.
    """
    counts = cv2.GaussianBlur(to_grey(image) * np.float32(255.0 / np.iinfo(image.dtype).max), (0, 0), 0.7)
    beneath = _lower_envelope(counts, int(np.ceil(2.5 * radius_px)))
    window = np.ones(
        (2 * max(1, round(0.375 * radius_px)) + 1,) * 2, np.uint8
    )  # odd: an even one shifts the image
    opened = cv2.dilate(cv2.erode(counts, window), window)
    strength = np.maximum(opened - beneath, 0)
    dots = cv2.dilate(counts, window) - beneath
    mask = strength > np.maximum(_FLAT_SHARE * dots, _NOISE_COUNTS)
    fine = np.ones((2 * max(1, round(_DOT_WINDOW * radius_px)) + 1,) * 2, np.uint8)
    highest = cv2.dilate(counts, fine)
    peak = np.where(counts == highest, highest - cv2.erode(counts, fine), np.float32(0))

    def surround(u: float, v: float, radius: float) -> float:
        return _dots_about(peak, strength, u, v, radius)

    return Evidence(mask, strength, surround)


def _dots_about(
    peak: NDArray[np.float32], strength: NDArray[np.float32], u: float, v: float, radius: float
) -> float:
    """Dots on the ring about a disc over half of what the pattern puts there; 0 where there are too few.

    A dot is a local maximum that stands out by half as much as the disc does: red is not brighter than gold. Stones
    without a pattern on them have edges, but not some thirty peaks on a ring.
    """
    reach = int(np.ceil(_RING[1] * radius))
    y0, x0 = max(int(v) - reach, 0), max(int(u) - reach, 0)
    near = (slice(y0, int(v) + reach + 1), slice(x0, int(u) + reach + 1))
    rows, columns = np.indices(peak[near].shape)
    distance = np.hypot(columns + x0 - u, rows + y0 - v)
    ring = (distance > _RING[0] * radius) & (distance < _RING[1] * radius)
    inside = distance < 0.6 * radius
    if not ring.any() or not inside.any():
        return 0.0
    level = float(np.median(strength[near][inside]))
    around, within = (float((peak[near][part] > 0.5 * level).mean()) for part in (ring, inside))
    share = around * radius**2 / _DOTS
    return 2 * share if share > _FEWEST and within < _INSIDE * around else 0.0


def _red_is_enough(u: float, v: float, radius: float) -> float:
    del u, v, radius
    return 1.0


def _lower_envelope(plane: NDArray[np.float32], window_px: int) -> NDArray[np.float32]:
    """(H, W) lowest value within a window, smoothed: the ambient light in the gaps between dots."""
    height, width = plane.shape
    low = cv2.erode(plane, np.ones((_REDUCED, _REDUCED), np.uint8))[::_REDUCED, ::_REDUCED]
    size = max(1, window_px // _REDUCED)
    low = cv2.boxFilter(cv2.erode(low, np.ones((size, size), np.uint8)), -1, (size, size))
    return np.asarray(cv2.resize(low, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)


def _local_ratio(
    above: NDArray[np.float32], below: NDArray[np.float32], window_px: float
) -> NDArray[np.float32]:
    """(H, W) ratio of two planes, each averaged over a window; within a factor 2 of that of the whole image."""
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
