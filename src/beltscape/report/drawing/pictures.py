"""Titled pictures with marks and legends, as parts of a page or drawn as one image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import Image, to_grey
from beltscape.report.drawing.legend import (
    PAPER,
    QUIET,
    Color,
    Rgb,
    Scale,
    Swatches,
    draw_scale_with_key,
    draw_text,
    measure_text,
)

PANEL_PX = 800
"""Width of a panel."""
_MARGIN_PX = 12
"""Margin about a panel's picture, title and legend."""
_BODY_PX = PANEL_PX - 2 * _MARGIN_PX
"""Width of a panel's picture."""
_HEAD_PX = 36
"""Height of a panel's title."""
_MARK_PX = 20
"""Height of a mark's text."""
_BRIGHT_SHARE = 0.995
"""Quantile that is drawn white: fewer pixels are glints."""
_GAMMA = 0.6
"""Exponent of the grey levels, which brightens dark scenes such as coal and rubber."""


@dataclass(frozen=True, slots=True)
class Mark:
    """A word on a picture, legible at any size."""

    text: str
    place: tuple[float, float]
    """Its centre, as shares of the picture's width and height."""
    color: Color = (255, 255, 255)


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """A picture with its title, a note to the right of the title, and its legend below."""

    image: Rgb
    title: str
    legend: Scale | Swatches | None = None
    key: Swatches | None = None
    """Key of the colours for missing values."""
    note: str = ""
    marks: Sequence[Mark] = ()

    def draw(self) -> Rgb:
        """Draw picture, title, note and legend as one image, ``PANEL_PX`` wide."""
        body = _resize(self.image, _BODY_PX)
        for mark in self.marks:
            _draw_mark(body, mark)
        head = np.full((_HEAD_PX, _BODY_PX, 3), PAPER, np.uint8)
        scale = self.legend if isinstance(self.legend, Scale) else None
        draw_text(head, f"{self.title} ({scale.label})" if scale and scale.label else self.title, (0, 26), 18)
        draw_text(head, self.note, (_BODY_PX - measure_text(self.note, 14), 26), 14, QUIET)
        parts = [head, body]
        if scale is not None and self.key is not None:
            parts.append(draw_scale_with_key(scale, self.key, _BODY_PX))
        elif self.legend is not None:
            parts.append(self.legend.legend(_BODY_PX))
        sides = ((0, _MARGIN_PX // 2), (_MARGIN_PX, _MARGIN_PX), (0, 0))
        return np.pad(np.concatenate(parts), sides, constant_values=PAPER[0])

    @property
    def legends(self) -> list[Scale | Swatches]:
        """Return the legend and the key, without missing ones."""
        return [each for each in (self.legend, self.key) if each is not None]


def arrange_panels(panels: Sequence[Panel], columns: int) -> Rgb:
    """Draw the panels on white in rows of ``columns``."""
    drawn = [panel.draw() for panel in panels]
    rows = [drawn[i : i + columns] for i in range(0, len(drawn), columns)]
    width = PANEL_PX * min(columns, len(drawn))
    heights = [max(p.shape[0] for p in row) for row in rows]
    page = np.full((sum(heights), width, 3), PAPER, np.uint8)
    top = 0
    for row, height in zip(rows, heights, strict=True):
        for i, one in enumerate(row):
            page[top : top + one.shape[0], i * PANEL_PX : (i + 1) * PANEL_PX] = one
        top += height
    return page


def quantile_range(values: NDArray[np.floating], share: float = 0.005) -> tuple[float, float]:
    """Return the range of the finite values without the outer ``share`` on both sides; (0, 1) without any."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return 0.0, 1.0
    low, high = np.quantile(finite, [share, 1 - share])
    return float(low), float(max(high, low + 1e-6))


def to_rgb(image: Image | NDArray[np.float32]) -> Rgb:
    """Return an image as 8-bit RGB, with dark scenes brightened."""
    top = max(float(np.quantile(to_grey(image), _BRIGHT_SHARE)), 1.0)
    bright = np.clip(image.astype(np.float32) / top, 0, 1) ** _GAMMA
    eight = np.rint(255 * bright).astype(np.uint8)
    return eight if eight.ndim == 3 else np.repeat(eight[..., None], 3, axis=2)


def limit_width(image: Rgb, width_px: int = PANEL_PX) -> Rgb:
    """Return an image reduced to at most ``width_px``."""
    return image if image.shape[1] <= width_px else _resize(image, width_px)


def _resize(image: Rgb, width_px: int) -> Rgb:
    factor = width_px / image.shape[1]
    way = cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR
    size = (width_px, max(round(image.shape[0] * factor), 1))
    return np.array(cv2.resize(image, size, interpolation=way), np.uint8)


def _draw_mark(image: Rgb, mark: Mark) -> None:
    """Draw a mark with a contrasting outline, in place."""
    height, width = image.shape[:2]
    left = round(mark.place[0] * width) - measure_text(mark.text, _MARK_PX) // 2
    base = round(mark.place[1] * height) + _MARK_PX // 3
    rim = (0, 0, 0) if is_light(mark.color) else (255, 255, 255)
    for shift in ((-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, 1), (-1, 1), (1, -1)):
        draw_text(image, mark.text, (left + shift[0], base + shift[1]), _MARK_PX, rim)
    draw_text(image, mark.text, (left, base), _MARK_PX, mark.color)


def is_light(color: Color) -> bool:
    """Return whether black has more contrast on a colour than white."""
    return 0.299 * color[0] + 0.587 * color[1] + 0.114 * color[2] > 140
