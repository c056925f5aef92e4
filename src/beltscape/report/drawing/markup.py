"""HTML attributes of pictures and legends: data URIs, positions in percent, CSS colours."""

from __future__ import annotations

from base64 import b64encode

import cv2
import numpy as np
from markupsafe import Markup

from beltscape.report.drawing.charts import KeyEntry
from beltscape.report.drawing.legend import Color, Rgb, Scale
from beltscape.report.drawing.pictures import PANEL_PX, is_light, limit_width

_QUALITY = 82
"""WebP quality; at 82 speckle stays sharp at half the size of a JPEG of equal appearance."""
_SMALL_PX = 520
"""Width of a picture in a row of three or more: twice its displayed width on a wide page."""
_STEPS = 2
"""Smallest number of intervals between ticks, so that their texts fit when a phone shows two pictures in a row."""

_PROSE = 36
"""Number of characters above which a cell is set as prose."""
_END = 5.0
"""Distance from an end, percent, within which a centred tick text would extend beyond it."""


def image_uri(image: Rgb, columns: int) -> str:
    """Return a picture as a data URI, at the width for a row of ``columns`` pictures."""
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
    """Return (position in percent, text) of the ticks of a scale."""
    return [(f"{100 * share:.2f}", text) for share, text in scale.marks(_STEPS)]


def side(place: str) -> str:
    """Return the alignment of a tick's text: centred, or inwards at an end of the scale."""
    return "low" if float(place) < _END else "high" if float(place) > 100 - _END else "middle"


def css(color: Color) -> str:
    """Return a picture's colour in CSS; it is the same on light and dark ground."""
    return "#{:02x}{:02x}{:02x}".format(*color)


def rim(color: Color) -> str:
    """Return the colour of the outline of a word on a picture."""
    return "#000" if is_light(color) else "#fff"


def cell_class(cell: str | KeyEntry) -> Markup:
    """Return the class attribute of a table cell: prose is left-aligned and wraps, a state does not wrap."""
    if isinstance(cell, KeyEntry):
        return Markup(' class="state"')
    return Markup(' class="text"') if len(cell) > _PROSE else Markup("")


def _uri(image: Rgb, ending: str, words: list[int], media: str) -> str:
    done, data = cv2.imencode(ending, np.ascontiguousarray(image[..., ::-1]), words)
    assert done
    return f"data:{media};base64," + b64encode(data.tobytes()).decode()
