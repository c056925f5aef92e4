"""The projected markers in one camera's image: discs ten times larger than the dots, red where there is colour."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import Image
from beltscape.stereo.markers.evidence import Evidence, flat_evidence, red_evidence

MOST = 40
"""Candidates kept: the 16 markers, each perhaps in two parts, and a few false ones."""
_SMALLEST_PX = 4.0
"""Radius below which nothing is searched: the dots would be four tenths of a pixel."""
_SMALLEST_FLAT_PX = 10.0
"""The same in grey images, where the dots between must be resolved."""
_WORKING_PX = (900, 1800)
"""Grey images with a longer side below are enlarged twice, above halved."""
_COLORLESS = 0.03
"""Spread of the channels over the brightest one: JPEG leaves a trace of colour."""
_LADDER = 1.6
"""Step between the radii a grey image is searched with."""
_FULLEST = 1.25
"""Area over that of the ellipse with the same second moments: 1 for an ellipse or half of one, less for a bow."""
_EMPTIEST_RED, _EMPTIEST_FLAT = 0.4, 0.7
"""Least fullness: red is evidence enough for a disc torn by relief, what is merely flat must look like a disc."""
_LONGEST = 4.0
"""Longest over shortest axis: a disc seen at 60° on a surface lit at 60° has 4."""


@dataclass(frozen=True, slots=True, eq=False)
class Markers:
    """Candidates for markers in one image, the best first; not yet said which is which."""

    center_px: NDArray[np.float64]
    """(N, 2) u, v of the centroid of what is visible of the disc, in the image as it is (distorted)."""
    radius_px: NDArray[np.float64]
    """(N,) of the circle with the visible area."""
    confidence: NDArray[np.float64]
    """(N,) 0..1: how much it looks like an undisturbed disc."""

    def __len__(self) -> int:
        return len(self.radius_px)


def find_markers(image: Image) -> Markers:
    """Candidates for markers in an image (H, W, 3) RGB or (H, W) grey, uint8 or uint16; none where there are none.

    Colour decides where there is colour: red against the gold of the dots, whatever the exposure and the white
    balance. In grey images a marker is what is without texture, bright and round among dots.

    References
    ----------
    Hou, Kang & Qiao, Sensors 2025, 25(7), 2111, doi:10.3390/s25072111, section 2.1.
    """
    if image.ndim == 3 and not _colorless(image):
        smallest, largest = _radii(image)
        return _best(_discs(red_evidence(image, largest), (0.5 * smallest, largest), _EMPTIEST_RED))
    image, factor = _working(image if image.ndim == 2 else image[..., 1])
    smallest, largest = _radii(image)
    found: list[_Disc] = []
    radius = max(smallest, _SMALLEST_FLAT_PX)
    while radius < largest:
        found += _discs(flat_evidence(image, radius), (0.5 * radius, 1.5 * radius), _EMPTIEST_FLAT)
        radius *= _LADDER
    markers = _best(found)
    # pixel (0, 0) is the centre of the top-left pixel at either size
    return replace(
        markers, center_px=(markers.center_px + 0.5) / factor - 0.5, radius_px=markers.radius_px / factor
    )


def _radii(image: Image) -> tuple[float, float]:
    """Between which radii, px, markers are searched: an image that shows the pattern and little else has 1/74."""
    longest = max(image.shape[:2])
    return max(longest / 250.0, _SMALLEST_PX), longest / 30.0


def _colorless(image: Image) -> bool:
    """Whether an RGB image is a grey one in three copies; gold has no blue."""
    few = image[::8, ::8, :3].astype(np.float64)
    return float(np.ptp(few, axis=2).sum()) <= _COLORLESS * float(few.max(axis=2).sum())


def _working(image: Image) -> tuple[Image, float]:
    """A grey image at the size where a window of whole pixels is fine enough and not slow, and how much larger."""
    longest = max(image.shape)
    factor = 2.0 if longest < _WORKING_PX[0] else 0.5 if longest > _WORKING_PX[1] else 1.0
    if factor == 1.0:
        return image, factor
    size = (int(image.shape[1] * factor), int(image.shape[0] * factor))
    way = cv2.INTER_CUBIC if factor > 1 else cv2.INTER_AREA
    return cast(Image, cv2.resize(image, size, interpolation=way)), factor


@dataclass(frozen=True, slots=True)
class _Disc:
    u: float
    v: float
    radius: float
    confidence: float


def _discs(evidence: Evidence, radii_px: tuple[float, float], emptiest: float) -> list[_Disc]:
    """Connected parts of the evidence with the size and shape of a disc, or of most of one."""
    smallest, largest = radii_px
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(evidence.mask.view(np.uint8))
    areas = boxes[:count, cv2.CC_STAT_AREA]
    wanted = (areas >= 0.5 * np.pi * smallest**2) & (areas <= 1.3 * np.pi * largest**2)
    wanted[0] = False
    largest_first = np.argsort(-areas[wanted], kind="stable")[: 4 * MOST]
    discs = []
    for label in np.flatnonzero(wanted)[largest_first]:
        disc = _measured(evidence, labels, int(label), boxes[label], emptiest)
        if disc is not None and smallest <= disc.radius <= largest:
            discs.append(disc)
    return discs


def _measured(
    evidence: Evidence, labels: NDArray[np.int32], label: int, box: NDArray[np.int32], emptiest: float
) -> _Disc | None:
    """Centroid and area of one part, its soft edge included; None where it is no disc."""
    x, y, w, h = (int(n) for n in box[:4])
    x0, y0 = max(x - 3, 0), max(y - 3, 0)
    near = (slice(y0, y + h + 3), slice(x0, x + w + 3))
    own = labels[near] == label
    around = cv2.dilate(own.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
    # the plateau is a local one: half of a disc may lie on a white module, half on black rubber
    plateau = cv2.dilate(np.where(own, evidence.strength[near], 0), np.ones((7, 7), np.uint8))
    share = evidence.strength[near] / np.maximum(0.95 * plateau, np.float32(1e-6))
    weight = np.where(around, np.clip(share, 0, 1), 0).astype(np.float64)
    v, u = np.indices(own.shape)
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
    if not emptiest < fullness < _FULLEST or elongation > _LONGEST:
        return None
    radius = float(np.sqrt(area / np.pi))
    dots = evidence.surround(x0 + cu, y0 + cv, radius)
    if dots <= 0:
        return None
    confidence = min(fullness, 1.0) ** 2 / elongation * min(dots, 1.0)
    return _Disc(x0 + cu, y0 + cv, radius, float(confidence))


def _best(discs: list[_Disc]) -> Markers:
    """The most confident ones, of overlapping ones the best (a grey disc answers at more than one radius)."""
    kept: list[_Disc] = []
    for disc in sorted(discs, key=lambda d: (-d.confidence, d.v, d.u)):
        apart = all(
            np.hypot(disc.u - other.u, disc.v - other.v) > 0.7 * max(disc.radius, other.radius)
            for other in kept
        )
        if apart:
            kept.append(disc)
    kept = kept[:MOST]
    return Markers(
        np.array([[d.u, d.v] for d in kept], np.float64).reshape(-1, 2),
        np.array([d.radius for d in kept], np.float64),
        np.array([d.confidence for d in kept], np.float64),
    )
