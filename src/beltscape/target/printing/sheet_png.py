"""A sheet as a grey image at a given resolution, with exact anti-aliasing of edges."""

from __future__ import annotations

import struct
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import SettingsError
from beltscape.files.rasters.images import encode_image
from beltscape.target.printing.sheet import Sheet

MAX_PIXELS = 400_000_000
"""Largest number of pixels of a sheet, 400 MB in memory: DIN A0 at 400 dots per inch has 248 million."""
STRIP_ROWS = 512
"""Rows drawn at once."""
LETTER_OVERSAMPLE = 8
"""Letters are drawn this many times finer and averaged."""


def draw_sheet(sheet: Sheet, dpi: float) -> NDArray[np.uint8]:
    """Return (H, W) grey; each pixel is the mean of the paper in it. x mm lies at pixel x·dpi/25.4 - 0.5.

    Raises
    ------
    SettingsError
        If the image would be too large.
    """
    scale = dpi / 25.4
    width, height = (max(round(side * scale), 1) for side in sheet.size_mm)
    if width * height > MAX_PIXELS:
        max_dpi = int(dpi * (MAX_PIXELS / (width * height)) ** 0.5)
        raise SettingsError(f"dpi {dpi:g} makes an image of {width}×{height} px; give at most {max_dpi} dpi")
    left, top, box_width, box_height = sheet.rectangles_mm.T * scale
    edges = np.stack([left, top, left + box_width, top + box_height], axis=-1)
    image = np.empty((height, width), dtype=np.uint8)
    for start in range(0, height, STRIP_ROWS):
        ink = np.zeros((min(STRIP_ROWS, height - start), width), dtype=np.float32)
        inside = edges[(edges[:, 3] > start) & (edges[:, 1] < start + len(ink))]
        for x0, y0, x1, y1 in inside.tolist():
            _add_box(ink, x0, y0 - start, x1, y1 - start)
        image[start : start + len(ink)] = np.rint(255 * (1 - np.minimum(ink, 1)))
    _draw_letters(image, [outline * scale for outline in sheet.outlines_mm])
    return image


def sheet_to_png(sheet: Sheet, dpi: float) -> bytes:
    """Return the sheet as PNG with its resolution, so that it also prints in true size."""
    data = encode_image(draw_sheet(sheet, dpi))
    per_metre = round(dpi / 0.0254)
    chunk = b"pHYs" + struct.pack(">IIB", per_metre, per_metre, 1)
    chunk = struct.pack(">I", 9) + chunk + struct.pack(">I", crc32(chunk))
    end = 8 + 25  # signature and IHDR come first in every PNG
    return data[:end] + chunk + data[end:]


def _add_box(ink: NDArray[np.float32], x0: float, y0: float, x1: float, y1: float) -> None:
    rows, across = _covered_shares(y0, y1, ink.shape[0])
    columns, along = _covered_shares(x0, x1, ink.shape[1])
    ink[rows, columns] += across[:, None] * along


def _covered_shares(low: float, high: float, count: int) -> tuple[slice, NDArray[np.float32]]:
    """Return the slice of ``count`` cells [i, i + 1] that an interval touches, and the covered share of each."""
    first, last = max(int(np.floor(low)), 0), min(int(np.ceil(high)), count)
    cells = np.arange(first, max(last, first))
    share = np.minimum(cells + 1, high) - np.maximum(cells, low)
    return slice(first, first + cells.size), np.clip(share, 0, 1).astype(np.float32)


def _draw_letters(image: NDArray[np.uint8], outlines: list[NDArray[np.float64]]) -> None:
    """Draw polygons, px from the image's corner, by the even-odd rule."""
    import cv2

    if not outlines:
        return
    points = np.concatenate(outlines)
    x0, y0 = np.maximum(np.floor(points.min(axis=0)).astype(int), 0)
    x1, y1 = np.minimum(np.ceil(points.max(axis=0)).astype(int) + 1, image.shape[::-1])
    fine = np.zeros(((y1 - y0) * LETTER_OVERSAMPLE, (x1 - x0) * LETTER_OVERSAMPLE), dtype=np.uint8)
    shift = 4
    polygons = [
        np.rint(((outline - (x0, y0)) * LETTER_OVERSAMPLE - 0.5) * (1 << shift)).astype(np.int32)
        for outline in outlines
    ]
    cv2.fillPoly(fine, polygons, 255, shift=shift)
    ink = fine.reshape(y1 - y0, LETTER_OVERSAMPLE, x1 - x0, LETTER_OVERSAMPLE).mean(axis=(1, 3))
    window = image[y0:y1, x0:x1]
    window[:] = np.rint(np.maximum(window - ink, 0))
