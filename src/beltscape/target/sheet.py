"""A sheet to print, black shapes on white paper in millimetres, and its files.

PDF: one page of exactly its size, with the same bytes every time. PNG: a grey image at a given resolution, with exact
anti-aliasing of edges. SVG: its size in mm, one unit is 1 mm.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cache
from xml.sax.saxutils import escape
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import SettingsError
from beltscape.files.images import encode_image


@dataclass(frozen=True, slots=True, eq=False)
class Sheet:
    """The content of a page. The origin is its top-left corner, x right, y down."""

    size_mm: tuple[float, float]
    title: str
    rectangles_mm: NDArray[np.float64]
    """(R, 4) x, y, width, height of black rectangles; they may touch and overlap."""
    outlines_mm: tuple[NDArray[np.float64], ...]
    """Closed polygons (P, 2) of letters, filled by the even-odd rule, because fonts differ between printers."""


def format_length(value: float) -> str:
    """Return a length as text: to the nanometre, without trailing zeros."""
    text = f"{value:.6f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def outline_text(text: str, height_mm: float) -> tuple[list[NDArray[np.float64]], float]:
    """Return the outlines of a line of text, (P, 2) mm each, y down from the base line, and its width in mm.

    ``height_mm`` is the font's size, about 1.4 times the height of a capital.
    """
    unit, advance = _outline_unit_text(text)
    return [outline * height_mm for outline in unit], advance * height_mm


@cache
def _outline_unit_text(text: str) -> tuple[list[NDArray[np.float64]], float]:
    """Return outlines and width for a font of size 1."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    size = 1000.0  # curves become chords at this size, far below a printer's resolution
    path = TextPath((0, 0), text, size=size, prop=FontProperties(family="DejaVu Sans"))
    outlines = [np.asarray(p, dtype=np.float64)[:-1] / (size, -size) for p in path.to_polygons()]
    return outlines, max(float(outline[:, 0].max()) for outline in outlines)


POINTS_PER_MM = 72 / 25.4
"""A point is 1/72 inch (ISO 32000-1, 8.3.2.3)."""


def sheet_to_pdf(sheet: Sheet) -> bytes:
    """Return the PDF file. One path holds all rectangles, so that no hairline appears where they touch.

    The file requests that viewers do not scale the print (ISO 32000-1, 12.2).
    """
    width, height = (side * POINTS_PER_MM for side in sheet.size_mm)
    content = _draw_content(sheet, height)
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {format_length(width)} {format_length(height)}] "
        "/Resources << >> /Contents 4 0 R >>".encode("ascii"),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
        b"<< /Title <%s> /Producer (Beltscape) >>" % sheet.title.encode("utf-16").hex().upper().encode(),
    ]
    return _assemble_file(objects)


def _draw_content(sheet: Sheet, height_points: float) -> bytes:
    """Return the drawing operators, in mm with y down."""
    scale = f"{POINTS_PER_MM:.12f}"
    lines = [f"{scale} 0 0 -{scale} 0 {format_length(height_points)} cm", "0 g"]
    lines += [" ".join(map(format_length, row)) + " re" for row in sheet.rectangles_mm.tolist()]
    lines.append("f")
    for outline in sheet.outlines_mm:
        lines += _draw_polygon(outline)
    return "\n".join([*lines, "f*"]).encode("ascii")


def _draw_polygon(outline: NDArray[np.float64]) -> list[str]:
    points = [f"{format_length(x)} {format_length(y)}" for x, y in outline.tolist()]
    return [f"{points[0]} m", *(f"{point} l" for point in points[1:]), "h"]


def _assemble_file(objects: list[bytes]) -> bytes:
    """Return header, objects, cross-reference table and trailer (ISO 32000-1, 7.5)."""
    data = b"%PDF-1.6\n%\xe2\xe3\xcf\xd3\n"
    starts: list[int] = []
    for index, body in enumerate(objects, start=1):
        starts.append(len(data))
        data += b"%d 0 obj\n%s\nendobj\n" % (index, body)
    table = b"".join(b"%010d 00000 n \n" % start for start in starts)
    return data + (
        b"xref\n0 %d\n0000000000 65535 f \n%s" % (len(objects) + 1, table)
        + b"trailer\n<< /Size %d /Root 1 0 R /Info %d 0 R >>\n" % (len(objects) + 1, len(objects))
        + b"startxref\n%d\n%%%%EOF\n" % len(data)
    )


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


def sheet_to_svg(sheet: Sheet) -> str:
    """Return the SVG text; one path holds all rectangles, so that no hairline appears where they touch."""
    width, height = map(format_length, sheet.size_mm)
    boxes = "\n".join(
        f"M{format_length(x)} {format_length(y)}h{format_length(w)}v{format_length(h)}h{format_length(-w)}z"
        for x, y, w, h in sheet.rectangles_mm.tolist()
    )
    outlines = "\n".join(
        "M" + "L".join(f"{format_length(x)} {format_length(y)}" for x, y in outline.tolist()) + "z"
        for outline in sheet.outlines_mm
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}mm" height="{height}mm" '
        f'viewBox="0 0 {width} {height}">\n<title>{escape(sheet.title)}</title>\n'
        f'<rect width="{width}" height="{height}" fill="#fff"/>\n'
        f'<path d="{boxes}"/>\n<path fill-rule="evenodd" d="{outlines}"/>\n</svg>\n'
    )
