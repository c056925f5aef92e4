"""Detection of the projected markers in one image: discs ten times larger than the dots, red in colour images."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import Image
from beltscape.stereo.markers.response import (
    MarkerResponse,
    compute_flat_response,
    compute_red_response,
    smooth_counts,
)

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
