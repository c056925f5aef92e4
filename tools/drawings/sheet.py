"""SVG sheets for the manual's drawings; for the programs beside it."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, hypot, pi, sin

Point = tuple[float, float]
STYLE = """<style>text{font:13px sans-serif;fill:#222}.t{font-size:15px;font-weight:bold}.c{fill:#1f5fa8}
.a{fill:#c02f2f;font-style:italic;font-weight:bold}.b{fill:#1d7a46}.l{fill:#8a6000}.s{font-size:11.5px}.r{fill:#c02f2f}</style>"""
CAMERA, AXIS, BELT, LIGHT, BOX = "#1f5fa8", "#c02f2f", "#3c3c3c", "#b07a00", "#1d7a46"


class Sheet:
    """SVG elements in drawing units about an origin, the second coordinate upwards."""

    def __init__(self, left: float, down: float, scale: float) -> None:
        """Place the origin at (left, down) px of the page; ``scale`` is px per unit."""
        self.left, self.down, self.scale, self.parts = left, down, scale, list[str]()

    def at(self, point: Point) -> Point:
        """Return the position on the page, px."""
        return self.left + self.scale * point[0], self.down - self.scale * point[1]

    def line(
        self, points: Sequence[Point], color: str, width: float = 1.5, dash: str = "", fill: str = "none"
    ) -> None:
        """Draw a line through points; filled, it is closed."""
        places = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(self.at, points))
        kind = "polyline" if fill == "none" else "polygon"
        dashes = f' stroke-dasharray="{dash}"' if dash else ""
        self.parts.append(
            f'<{kind} points="{places}" fill="{fill}" stroke="{color}" stroke-width="{width}"{dashes}/>'
        )

    def text(self, point: Point, words: str, kind: str = "", anchor: str = "start") -> None:
        """Write words at a position."""
        x, y = self.at(point)
        self.parts.append(
            f'<text x="{x:.1f}" y="{y:.1f}" class="{kind}" text-anchor="{anchor}">{words}</text>'
        )

    def dot(self, point: Point, color: str, radius_px: float = 4.0, fill: str = "") -> None:
        """Draw a disc."""
        x, y = self.at(point)
        self.parts.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius_px}" fill="{fill or color}" stroke="{color}" '
            'stroke-width="1.5"/>'
        )

    def arrow(
        self, start: Point, end: Point, color: str, width: float = 2.2, head_px: float = 10.12, dash: str = ""
    ) -> None:
        """Draw an arrow."""
        length = hypot(end[0] - start[0], end[1] - start[1])
        x, y = (end[0] - start[0]) / length, (end[1] - start[1]) / length
        back, side = head_px / self.scale, 9 / 22 * head_px / self.scale
        head = [(end[0] - back * x + i * side * y, end[1] - back * y - i * side * x) for i in (1, -1)]
        self.line([start, end], color, width, dash)
        self.line([end, *head], color, 1, fill=color)

    def box(self, low: Point, high: Point, color: str, fill: str, words: Sequence[str] = ()) -> None:
        """Draw a rectangle with lines of text in its middle."""
        self.line([low, (low[0], high[1]), high, (high[0], low[1])], color, 1.2, fill=fill)
        x, y = (low[0] + high[0]) / 2, (low[1] + high[1]) / 2
        for i, line in enumerate(words):
            offset = (len(words) - 1) / 2 - i
            self.text((x, y + (15 * offset - 4.5) / self.scale), line, "s", "middle")

    def circle(self, centre: Point, radius: float, color: str, width: float = 1.2, dash: str = "") -> None:
        """Draw a circle of a radius in drawing units."""
        turns = [2 * pi * k / 48 for k in range(49)]
        self.line(
            [(centre[0] + radius * cos(a), centre[1] + radius * sin(a)) for a in turns], color, width, dash
        )


def document(title: str, size_px: tuple[int, int], sheets: Sequence[Sheet]) -> str:
    """Return the sheets on one page as SVG."""
    width, height = size_px
    parts = "\n".join(part for sheet in sheets for part in sheet.parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
        f'height="{height}" role="img">\n<title>{title}</title>\n'
        f'{STYLE}\n<rect width="{width}" height="{height}" fill="#fff"/>\n{parts}\n</svg>\n'
    )
