"""Pictures of the lumps: coloured by size on the shaded surface, and outlined on the camera image."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.depth import DepthMap
from beltscape.core.frames import Image, to_grey
from beltscape.measure.lumps.lumps import FINES, Lumps
from beltscape.measure.lumps.shape import Lump
from beltscape.report.drawing.depth_picture import LIGHT
from beltscape.report.drawing.legend import HEIGHT, Color, Rgb, Scale, Swatches
from beltscape.report.drawing.pictures import Mark, Panel, quantile_range, to_rgb

OVERSIZE: Color = (217, 0, 130)
"""Outline of oversize lumps; no other colour has this hue."""
BELT, FINE = (238, 240, 242), (178, 184, 190)
"""Colours without lumps: the bare belt, and fines."""
_OUTLINE, _SEEN_OUTLINE = (33, 37, 41), (255, 169, 77)
"""Colours of the outlines over the sizes, and over the image."""
_PALE, _PALE_TO = 0.45, 235
"""Share of its colour that a partly visible lump keeps, and the grey of the rest."""
_LARGEST = 12
"""Smallest number of numbered lumps in the table; all oversize lumps are added."""


def largest_lumps(lumps: Lumps) -> list[Lump]:
    """Return the lumps of the table in descending size; the pictures number these."""
    count = max(_LARGEST, len(_oversize_numbers(lumps)))
    return sorted(lumps.lumps, key=lambda lump: -lump.size_mm)[:count]


def make_lump_panels(lumps: Lumps, depth: DepthMap, picture: Image | None) -> list[Panel]:
    """Return the lumps outlined on the surface coloured by size, and outlined on the camera image."""
    area = crop_to_lumps(lumps)
    labels = lumps.labels[area]
    scale = Scale(*quantile_range(_sizes(lumps), 0.02), HEIGHT[40:])
    marks = _marks(lumps, labels)
    sized = _draw_outlines(
        color_by_size(labels, lumps, _shade_relief(depth)[area], scale), labels, lumps, _OUTLINE
    )
    panels = [Panel(sized, "size of the lumps, mm", scale, _key(labels, lumps), marks=marks)]
    if picture is not None:
        smooth = cv2.GaussianBlur(
            to_grey(picture), (0, 0), max(labels.shape) / 500
        )  # without the projected dots
        seen = _draw_outlines(to_rgb(np.asarray(smooth)[area]), labels, lumps, _SEEN_OUTLINE)
        outlines = Swatches([("outline of a lump", _SEEN_OUTLINE), *_oversize_swatch(lumps)])
        panels.append(Panel(seen, "what the core camera saw", outlines, marks=marks))
    return panels


def color_by_size(labels: NDArray[np.uint16], lumps: Lumps, relief: NDArray[np.float64], scale: Scale) -> Rgb:
    """Return the shaded lumps in the colours of their sizes, (H, W, 3); pixels without lumps in the key's colours."""
    pale = np.zeros(FINES + 1, bool)
    for lump in lumps.lumps:
        pale[lump.number] = lump.occluded or lump.cut
    colored = scale.to_rgb(_sizes(lumps)[labels]).astype(np.float64)
    weight = np.where(pale[labels], _PALE, 1.0)[..., None]
    shaded = (weight * colored + (1 - weight) * _PALE_TO) * relief[..., None]
    image = np.rint(np.clip(shaded, 0, 255)).astype(np.uint8)
    image[labels == 0] = BELT
    image[labels == FINES] = FINE
    return image


def _sizes(lumps: Lumps) -> NDArray[np.float64]:
    """Return the size of each label, (FINES + 1,) mm; NaN: no lump."""
    size = np.full(FINES + 1, np.nan)
    for lump in lumps.lumps:
        size[lump.number] = lump.size_mm
    return size


def _key(labels: NDArray[np.uint16], lumps: Lumps) -> Swatches:
    """Return the key of the colours that are no sizes."""
    entries: list[tuple[str, Color]] = []
    if (labels == 0).any():
        entries.append(("no lump", BELT))
    if (labels == FINES).any():
        entries.append(("fines", FINE))
    if any(lump.occluded or lump.cut for lump in lumps.lumps):
        middle = np.asarray(HEIGHT[148], np.float64)
        red, green, blue = (round(_PALE * float(c) + (1 - _PALE) * _PALE_TO) for c in middle)
        entries.append(("pale: partly hidden, or cut by the frame", (red, green, blue)))
    return Swatches([*entries, *_oversize_swatch(lumps)])


def _oversize_swatch(lumps: Lumps) -> list[tuple[str, Color]]:
    return (
        [(f"over {lumps.oversize.limit_mm:g} mm", OVERSIZE)]
        if lumps.oversize and _oversize_numbers(lumps)
        else []
    )


def _oversize_numbers(lumps: Lumps) -> list[int]:
    """Return the numbers of the lumps whose probability of oversize exceeds one half."""
    return [] if lumps.oversize is None else [n for n, chance in lumps.oversize.lumps if chance > 0.5]


def _marks(lumps: Lumps, labels: NDArray[np.uint16]) -> list[Mark]:
    """Return the numbers of the largest lumps, each on its lump."""
    marks: list[Mark] = []
    height, width = labels.shape
    for lump in largest_lumps(lumps):
        own = labels == lump.number
        if own.any():
            v, u = _find_innermost(own)
            marks.append(Mark(str(lump.number), ((u + 0.5) / width, (v + 0.5) / height)))
    return marks


def _find_innermost(own: NDArray[np.bool_]) -> tuple[int, int]:
    """Return row and column of the pixel farthest from the edge."""
    inside = ndimage.distance_transform_edt(np.pad(own, 1))
    v, u = np.unravel_index(int(np.argmax(inside)), own.shape + np.array([2, 2]))
    return int(v) - 1, int(u) - 1


def crop_to_lumps(lumps: Lumps) -> tuple[slice, slice]:
    """Return the rows and columns that contain lumps, with a margin; all without lumps."""
    there = np.argwhere(lumps.labels > 0)
    if not len(there):
        return np.s_[:, :]
    rim = max(lumps.labels.shape) // 40
    (top, left), (bottom, right) = there.min(axis=0), there.max(axis=0)
    return np.s_[max(top - rim, 0) : bottom + rim, max(left - rim, 0) : right + rim]


def _shade_relief(depth: DepthMap) -> NDArray[np.float64]:
    """Return the shading (H, W) of the surface lit from above left; 1 where it is level or not measured."""
    measured = depth.measured
    middle = float(np.median(depth.depth_mm[measured])) if measured.any() else 1.0
    z = cv2.medianBlur(np.where(measured, depth.depth_mm, middle).astype(np.float32), 5)
    z = cv2.GaussianBlur(z, (0, 0), 1.2)
    pixel = middle / (1.0 * max(depth.depth_mm.shape))  # the lens' angle is about one radian
    down, right = np.gradient(z.astype(np.float64))
    normal = np.stack([right / pixel, down / pixel, -np.ones_like(down)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    brighter = np.clip(normal @ LIGHT, 0, None) + LIGHT[2]
    return np.clip(1.0 + 0.7 * np.where(measured, brighter, 0.0), 0.3, 1.2)


def _draw_outlines(image: Rgb, labels: NDArray[np.uint16], lumps: Lumps, color: Color) -> Rgb:
    """Return the image (H, W, 3) with the outlines of all lumps, and those of oversize lumps on top."""
    thick = max(1, round(max(image.shape[:2]) / 600))
    edge = _edges(labels)
    wide = np.asarray(ndimage.binary_dilation(edge, np.ones((thick, thick))), bool) if thick > 1 else edge
    drawn = image.copy()
    drawn[wide] = color
    for number in _oversize_numbers(lumps):
        own = (labels == number).astype(np.uint8)
        outline, _ = cv2.findContours(own, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(drawn, outline, -1, OVERSIZE, max(2, image.shape[1] // 260))
    return drawn


def _edges(labels: NDArray[np.uint16]) -> NDArray[np.bool_]:
    edge = np.zeros(labels.shape, bool)
    edge[:, 1:] |= labels[:, 1:] != labels[:, :-1]
    edge[1:] |= labels[1:] != labels[:-1]
    lump = (labels > 0) & (labels < FINES)
    return edge & np.asarray(ndimage.binary_dilation(lump, np.ones((3, 3))), bool)
