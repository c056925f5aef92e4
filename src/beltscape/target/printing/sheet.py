"""A sheet to print: black shapes on white paper, in millimetres."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray


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
