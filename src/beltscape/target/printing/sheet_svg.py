"""A sheet as SVG: its size in mm, one unit is 1 mm."""

from __future__ import annotations

from xml.sax.saxutils import escape

from beltscape.target.printing.sheet import Sheet, format_length


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
