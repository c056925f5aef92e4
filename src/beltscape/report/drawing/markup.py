"""Pictures and legends as a page shows them: data URIs, places in percent, colours as CSS writes them."""

from __future__ import annotations

from base64 import b64encode

import cv2
import numpy as np
from markupsafe import Markup

from beltscape.report.drawing.charts import Entry
from beltscape.report.drawing.legend import Color, Rgb, Scale
from beltscape.report.drawing.pictures import PANEL_PX, is_light, limit_width

_QUALITY = 82
"""Of WebP: at 82 speckle stays sharp, at half the bytes of a JPEG that looks the same."""
_SMALL_PX = 520
"""Width of a picture of which three or more share a row: twice what a wide page shows of it."""
_STEPS = 2
"""Between a legend's ticks, at least: their texts do not meet where a phone shows two pictures side by side."""

_PROSE = 36
"""Characters beyond which a cell is no number."""
_END = 5.0
"""Percent from an end within which the text of a tick would reach beyond it."""


def image_uri(image: Rgb, columns: int) -> str:
    """Return a picture as a data URI, as wide as a row of so many needs it."""
    return _uri(
        limit_width(image, PANEL_PX if columns <= 2 else _SMALL_PX),
        ".webp",
        [cv2.IMWRITE_WEBP_QUALITY, _QUALITY],
        "image/webp",
    )


def ramp_uri(scale: Scale) -> str:
    """Return the colours of a scale from its low to its high end, pixel by pixel, as a data URI."""
    return _uri(scale.colormap[None], ".png", [], "image/png")


def ticks(scale: Scale) -> list[tuple[str, str]]:
    """Return (place in percent, text) of the ticks of a scale."""
    return [(f"{100 * share:.2f}", text) for share, text in scale.marks(_STEPS)]


def side(place: str) -> str:
    """Return where the text of a tick stands: at its middle, or inwards of an end of the scale."""
    return "low" if float(place) < _END else "high" if float(place) > 100 - _END else "middle"


def css(color: Color) -> str:
    """Return a colour of a picture, which is the same on light and on dark ground."""
    return "#{:02x}{:02x}{:02x}".format(*color)


def rim(color: Color) -> str:
    """Return the colour of the rim about a word on a picture."""
    return "#000" if is_light(color) else "#fff"


def cell_class(cell: str | Entry) -> Markup:
    """Return the class attribute of a table's cell: prose is set left and wraps, a state does not."""
    if isinstance(cell, Entry):
        return Markup(' class="state"')
    return Markup(' class="text"') if len(cell) > _PROSE else Markup("")


def _uri(image: Rgb, ending: str, words: list[int], media: str) -> str:
    done, data = cv2.imencode(ending, np.ascontiguousarray(image[..., ::-1]), words)
    assert done
    return f"data:{media};base64," + b64encode(data.tobytes()).decode()
