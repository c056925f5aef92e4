"""Charts of a page, drawn for wide screens and for phones, with the key to their colours."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from matplotlib.figure import Figure

from beltscape.report.drawing.legend import Scale, Swatches
from beltscape.report.drawing.palette import variable
from beltscape.report.drawing.plots import NARROW, WIDE, Form, to_svg

Mark = Literal["area", "line", "dashed", "dotted", "circle", "square", "triangle", "cross", "outline"]

_MARKS: dict[Mark, str] = {
    "area": '<rect x="3" y="1" width="16" height="12" rx="2" fill="C"/>',
    "outline": '<rect x="4" y="2" width="14" height="10" fill="none" stroke="C" stroke-width="2"/>',
    "line": '<path d="M0 7H22" stroke="C" stroke-width="2.5"/>',
    "dashed": '<path d="M0 7H22" stroke="C" stroke-width="2.5" stroke-dasharray="6 3"/>',
    "dotted": '<path d="M0 7H22" stroke="C" stroke-width="2.5" stroke-dasharray="2 3"/>',
    "circle": '<circle cx="11" cy="7" r="5" fill="C"/>',
    "square": '<rect x="6.5" y="2.5" width="9" height="9" fill="C"/>',
    "triangle": '<path d="M11 2 16.5 12H5.5Z" fill="C"/>',
    "cross": '<path d="M6.5 2.5 15.5 11.5M15.5 2.5 6.5 11.5" stroke="C" stroke-width="2.5"/>',
}


@dataclass(frozen=True, slots=True)
class KeyEntry:
    """A word with its mark in the charts; a cell of a table or an entry of a key."""

    text: str
    role: str
    """Role of its colour in the palette, or a colour "#rrggbb" of its own."""
    mark: Mark = "line"

    @property
    def sample(self) -> str:
        """Return the mark as an SVG element."""
        colour = self.role if self.role.startswith("#") else variable(self.role)
        body = _MARKS[self.mark].replace('"C"', f'"{colour}"')
        return f'<svg class="sample" viewBox="0 0 22 14" aria-hidden="true">{body}</svg>'


@dataclass(frozen=True, slots=True)
class ChartKey:
    """The key to the marks of a chart."""

    entries: Sequence[KeyEntry]
    kind: str = "key"


@dataclass(frozen=True, slots=True)
class Chart:
    """A drawing in two layouts."""

    wide: str
    narrow: str
    """SVG elements."""
    caption: str
    legends: Sequence[Scale | Swatches | ChartKey] = ()
    half: bool = False
    """Whether it shares its row with another one on wide screens."""
    kind: str = "chart"

    @classmethod
    def draw(
        cls, plot: Callable[[Form], Figure], caption: str, *legends: Scale | Swatches | ChartKey
    ) -> Chart:
        """Return a plot, drawn in both forms."""
        return cls(to_svg(plot, WIDE), to_svg(plot, NARROW), caption, legends)
