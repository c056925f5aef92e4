"""PNG canvas that draws texts whose characters the charts' font lacks, such as Chinese names, by OpenCV's fonts.

OpenCV brings fonts for Latin, Cyrillic, Greek, Chinese, Japanese, Korean and Arabic, so that a picture's bytes do not
depend on the fonts of a computer.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any
from warnings import catch_warnings, filterwarnings

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.font_manager import FontProperties, findfont, get_font

from beltscape.report.drawing.legend import Rgb, draw_text, measure_text

_DESCENT = 0.25
"""Depth of the longest descenders below the base line, over the size of the text (DejaVu Sans has 0.24)."""
_INK = 255
"""Value of ink in the mask that a text is drawn into."""


@contextmanager
def tolerate_missing_glyphs() -> Generator[None]:
    """Silence Matplotlib's warnings of characters that its font lacks: others draw them."""
    with catch_warnings():
        filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        yield


class FallbackCanvas(FigureCanvasAgg):
    """Canvas of a figure as PNG."""

    def get_renderer(self) -> RendererAgg:
        """Return the renderer, which is one for all measurements and drawings of one size."""
        width, height = self.get_width_height(physical=True)
        key = (width, height, self.figure.dpi)
        if self._lastKey != key:
            self.renderer, self._lastKey = _Renderer(width, height, self.figure.dpi), key
        return self.renderer


class _Renderer(RendererAgg):
    """Renderer that draws whole texts with OpenCV's fonts where the chart's font lacks a character of them."""

    def get_text_width_height_descent(
        self, s: str, prop: FontProperties, ismath: Any
    ) -> tuple[float, float, float]:
        """Return the size of a text and its depth below the base line, px."""
        if not s or ismath or not _lacks_glyphs(s):
            return super().get_text_width_height_descent(s, prop, ismath)
        size = self._find_size(prop)
        return float(measure_text(s, size)), size * (1 + _DESCENT), size * _DESCENT

    def draw_text(
        self, gc: Any, x: float, y: float, s: str, prop: FontProperties, angle: float, ismath: Any = False,
        mtext: Any = None,
    ) -> None:  # fmt: skip
        """Draw a text from the left end of its base line, px from the left and from above."""
        if not s or ismath or not _lacks_glyphs(s):
            super().draw_text(gc, x, y, s, prop, angle, ismath, mtext)
            return
        size = self._find_size(prop)
        below = round(size * _DESCENT)
        mask: Rgb = np.zeros((size + 2 * below, measure_text(s, size) + 2, 3), np.uint8)
        draw_text(mask, s, (0, size + below), size, (_INK, _INK, _INK))
        picture = np.empty((*mask.shape[:2], 4), np.uint8)
        picture[..., :3] = np.rint(np.array(gc.get_rgb()[:3]) * 255)
        picture[..., 3] = mask[..., 0]
        quarters = round(angle / 90) % 4
        left, bottom = (x, self.height - y - below) if quarters == 0 else (x - size - below, self.height - y)
        self.draw_image(gc, round(left), round(bottom), np.rot90(picture, quarters)[::-1].copy())

    def _find_size(self, prop: FontProperties) -> int:
        return max(1, round(prop.get_size_in_points() * self.dpi / 72))


@lru_cache(maxsize=4096)
def _lacks_glyphs(text: str) -> bool:
    """Return whether the charts' font lacks a character of a text."""
    font = get_font(findfont(FontProperties(family="DejaVu Sans")))
    return any(font.get_char_index(ord(char)) == 0 for char in text if not char.isspace())
