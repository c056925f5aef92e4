"""A pattern as SVG, for slides, gobos and glass masks."""

from __future__ import annotations

import numpy as np

from beltscape.target.speckle.pattern import Pattern
from beltscape.target.speckle.pattern_image import hex_from_rgb, rgb_from_hex


def pattern_to_svg(pattern: Pattern) -> str:
    """Return the SVG text of a pattern; one unit is one pixel, (0, 0) the centre of the top-left one."""
    (width, height), settings = pattern.size_px, pattern.settings
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'viewBox="-0.5 -0.5 {width} {height}">',
        f'<rect x="-0.5" y="-0.5" width="{width}" height="{height}" fill="{settings.background}"/>',
    ]
    low, high = rgb_from_hex(settings.background), rgb_from_hex(settings.dot_color)
    for level in np.unique(pattern.dots[:, 3]):
        dots = pattern.dots[pattern.dots[:, 3] == level]
        parts.append(f'<g fill="{hex_from_rgb(low + level * (high - low))}">')
        parts += [f'<circle cx="{x:.3f}" cy="{y:.3f}" r="{r:g}"/>' for x, y, r, _ in dots.tolist()]
        parts.append("</g>")
    parts.append(f'<g fill="{settings.marker_color}">')
    parts += [
        f'<circle cx="{m.center_px[0]:g}" cy="{m.center_px[1]:g}" r="{m.radius_px:g}"/>'
        for m in pattern.markers
    ]
    return "\n".join([*parts, "</g>", "</svg>"]) + "\n"
