"""A sheet as PDF: one page of exactly its size, with the same bytes every time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.target.printing.sheet import Sheet, format_length

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
