"""Detection of the projected markers in one image: discs ten times larger than the dots, red in colour images.

The detector responds to red among gold in colour images, to flat among dots in grey ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import cast

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


_MAX_DETECTIONS = 40
"""Detections kept: the 16 markers, each possibly in two parts, and a few false ones."""
_SMALLEST_PX = 4.0
"""Least radius that is searched; the dots of a smaller marker have a radius of less than 0.4 px."""
_SMALLEST_FLAT_PX = 10.0
"""Least radius in grey images, in which the dots between the markers must be resolved."""
_WORKING_PX = (900, 1800)
"""Grey images whose longer side is below the first are enlarged twice; above the second they are halved."""
_MAX_GREY_CHROMA = 0.03
"""Spread of the channels over the brightest one, up to which an image is grey; JPEG leaves a trace of colour."""
_RADIUS_STEP = 1.6
"""Factor between the radii with which a grey image is searched."""
_MAX_FULLNESS = 1.25
"""Area over that of the ellipse with the same second moments: 1 for an ellipse or half of one, less for an arc."""
_MIN_FULLNESS_RED, _MIN_FULLNESS_FLAT = 0.4, 0.7
"""Least fullness: red regions may be discs torn by relief; regions that are only flat must have a disc's shape."""
_MAX_ELONGATION = 4.0
"""Longest over shortest axis: 4 for a disc seen at 60° on a surface lit at 60°."""


@dataclass(frozen=True, slots=True, eq=False)
class MarkerDetections:
    """Detected discs in one image, the most confident first; not yet numbered."""

    center_px: NDArray[np.float64]
    """(N, 2) u, v of the centroid of the disc's visible part, in the distorted image."""
    radius_px: NDArray[np.float64]
    """(N,) radius of the circle with the visible area."""
    confidence: NDArray[np.float64]
    """(N,) 0..1: 1 for an undisturbed disc."""

    def __len__(self) -> int:
        return len(self.radius_px)


def detect_markers(image: Image) -> MarkerDetections:
    """Detect the markers in an image (H, W, 3) RGB or (H, W) grey, uint8 or uint16.

    In colour images markers are red among gold dots, independent of exposure and white balance. In grey images
    they are bright round regions without texture among dots.

    References
    ----------
    Hou, Kang & Qiao, Sensors 2025, 25(7), 2111, doi:10.3390/s25072111, section 2.1.
    """
    if image.ndim == 3 and not _is_grey(image):
        smallest, largest = _radius_range(image)
        response = compute_red_response(image, largest)
        return _suppress_overlaps(_find_discs(response, (0.5 * smallest, largest), _MIN_FULLNESS_RED))
    image, factor = _resize_for_search(image if image.ndim == 2 else image[..., 1])
    smallest, largest = _radius_range(image)
    counts = smooth_counts(image)
    discs: list[_Disc] = []
    radius = max(smallest, _SMALLEST_FLAT_PX)
    while radius < largest:
        response = compute_flat_response(counts, radius)
        discs += _find_discs(response, (0.5 * radius, 1.5 * radius), _MIN_FULLNESS_FLAT)
        radius *= _RADIUS_STEP
    markers = _suppress_overlaps(discs)
    # (0, 0) is the centre of the top-left pixel at both sizes
    return replace(
        markers, center_px=(markers.center_px + 0.5) / factor - 0.5, radius_px=markers.radius_px / factor
    )


def _radius_range(image: Image) -> tuple[float, float]:
    """Return the range of radii to search, px; a pattern that fills the image has 1/74 of its longer side."""
    longest = max(image.shape[:2])
    return max(longest / 250.0, _SMALLEST_PX), longest / 30.0


def _is_grey(image: Image) -> bool:
    """Return whether the channels of an RGB image are equal; gold has no blue."""
    sample = image[::8, ::8, :3].astype(np.float64)
    return float(np.ptp(sample, axis=2).sum()) <= _MAX_GREY_CHROMA * float(sample.max(axis=2).sum())


def _resize_for_search(image: Image) -> tuple[Image, float]:
    """Return a grey image resized for windows of whole pixels, and the factor of enlargement."""
    longest = max(image.shape)
    factor = 2.0 if longest < _WORKING_PX[0] else 0.5 if longest > _WORKING_PX[1] else 1.0
    if factor == 1.0:
        return image, factor
    size = (int(image.shape[1] * factor), int(image.shape[0] * factor))
    interpolation = cv2.INTER_CUBIC if factor > 1 else cv2.INTER_AREA
    return cv2.resize(image, size, interpolation=interpolation), factor


@dataclass(frozen=True, slots=True)
class _Disc:
    u: float
    v: float
    radius: float
    confidence: float


def _find_discs(response: MarkerResponse, radii_px: tuple[float, float], min_fullness: float) -> list[_Disc]:
    """Return the connected regions of the response with the size and shape of a disc, or of most of one."""
    smallest, largest = radii_px
    count, labels = cv2.connectedComponents(response.mask.view(np.uint8))
    pixels = np.flatnonzero(response.mask)  # few; OpenCV's own statistics take seven times as long
    regions = labels.ravel()[pixels]
    areas = np.bincount(regions, minlength=count)
    wanted = (areas >= 0.5 * np.pi * smallest**2) & (areas <= 1.3 * np.pi * largest**2)
    largest_first = np.argsort(-areas[wanted], kind="stable")[: 4 * _MAX_DETECTIONS]
    by_region, ends = pixels[np.argsort(regions, kind="stable")], np.cumsum(areas)
    discs: list[_Disc] = []
    for label in np.flatnonzero(wanted)[largest_first]:
        own = by_region[ends[label] - areas[label] : ends[label]]
        disc = _measure_disc(response, labels, int(label), _bound(own, labels.shape[1]), min_fullness)
        if disc is not None and smallest <= disc.radius <= largest:
            discs.append(disc)
    return discs


def _bound(pixels: NDArray[np.int64], width: int) -> tuple[int, int, int, int]:
    """Return the first and last column and the first and last row of ascending indices into an image's pixels."""
    columns = pixels % width
    return int(columns.min()), int(columns.max()), int(pixels[0]) // width, int(pixels[-1]) // width


def _measure_disc(
    response: MarkerResponse,
    labels: NDArray[np.int32],
    label: int,
    box: tuple[int, int, int, int],
    min_fullness: float,
) -> _Disc | None:
    """Return the disc with the centroid and area of one region and its soft edge; None where it is no disc."""
    left, right, top, bottom = box
    x0, y0 = max(left - 3, 0), max(top - 3, 0)
    near = (slice(y0, bottom + 4), slice(x0, right + 4))
    own = labels[near] == label
    around = cv2.dilate(own.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
    # the plateau is local, since half of a disc may lie on a white module and half on black rubber
    plateau = cv2.dilate(np.where(own, response.strength[near], 0), np.ones((7, 7), np.uint8))
    share = response.strength[near] / np.maximum(0.95 * plateau, np.float32(1e-6))
    weight = np.where(around, np.clip(share, 0, 1), 0).astype(np.float64)
    v, u = cast("NDArray[np.int64]", np.indices(own.shape))
    area = float(weight.sum())
    cu, cv = float((weight * u).sum() / area), float((weight * v).sum() / area)
    suu = float((weight * (u - cu) ** 2).sum() / area)
    svv = float((weight * (v - cv) ** 2).sum() / area)
    suv = float((weight * (u - cu) * (v - cv)).sum() / area)
    determinant, half_trace = suu * svv - suv * suv, (suu + svv) / 2
    if determinant <= 0:
        return None
    fullness = area / (4 * np.pi * np.sqrt(determinant))
    spread = np.sqrt(max(half_trace**2 - determinant, 0.0))
    elongation = np.sqrt((half_trace + spread) / max(half_trace - spread, 1e-9))
    if not min_fullness < fullness < _MAX_FULLNESS or elongation > _MAX_ELONGATION:
        return None
    radius = float(np.sqrt(area / np.pi))
    dots = response.dot_score(x0 + cu, y0 + cv, radius)
    if dots <= 0:
        return None
    confidence = min(fullness, 1.0) ** 2 / elongation * min(dots, 1.0)
    return _Disc(x0 + cu, y0 + cv, radius, float(confidence))


def _suppress_overlaps(discs: list[_Disc]) -> MarkerDetections:
    """Return the most confident discs, one of those that overlap: a grey disc is found at more than one radius."""
    kept: list[_Disc] = []
    for disc in sorted(discs, key=lambda d: (-d.confidence, d.v, d.u)):
        apart = all(
            np.hypot(disc.u - other.u, disc.v - other.v) > 0.7 * max(disc.radius, other.radius)
            for other in kept
        )
        if apart:
            kept.append(disc)
    kept = kept[:_MAX_DETECTIONS]
    return MarkerDetections(
        np.array([[d.u, d.v] for d in kept], np.float64).reshape(-1, 2),
        np.array([d.radius for d in kept], np.float64),
        np.array([d.confidence for d in kept], np.float64),
    )
