"""Pictures under titles, with legends that one can read, side by side."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import Image, grey
from beltscape.report.legend import PAPER, QUIET, Rgb, Scale, Swatches, keyed, text_width, write

PANEL_PX = 800
"""Width of a panel."""
_MARGIN_PX = 12
_BODY_PX = PANEL_PX - 2 * _MARGIN_PX
_HEAD_PX = 36


def span(values: NDArray[np.floating], share: float = 0.005) -> tuple[float, float]:
    """Range of the finite values without the outermost ``share`` on both sides; (0, 1) where there are none."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return 0.0, 1.0
    low, high = np.quantile(finite, [share, 1 - share])
    return float(low), float(max(high, low + 1e-6))


def panel(
    image: Rgb,
    title: str,
    legend: Scale | Swatches | None = None,
    *,
    key: Swatches | None = None,
    note: str = "",
) -> Rgb:
    """One picture, ``PANEL_PX`` wide, with its title, a note to the right of it, and its legend below.

    The key tells the colours that stand for no value of a scale.
    """
    factor = _BODY_PX / image.shape[1]
    way = cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR
    body = cv2.resize(image, (_BODY_PX, max(round(image.shape[0] * factor), 1)), interpolation=way)
    head = np.full((_HEAD_PX, _BODY_PX, 3), PAPER, np.uint8)
    write(head, title, (0, 26), 18)
    write(head, note, (_BODY_PX - text_width(note, 14), 26), 14, QUIET)
    parts = [head, np.asarray(body, np.uint8)]
    if isinstance(legend, Scale) and key is not None:
        parts.append(keyed(legend, key, _BODY_PX))
    elif legend is not None:
        parts.append(legend.legend(_BODY_PX))
    sides = ((0, _MARGIN_PX // 2), (_MARGIN_PX, _MARGIN_PX), (0, 0))
    return np.pad(np.concatenate(parts), sides, constant_values=PAPER[0])


def sheet(panels: Sequence[Rgb], columns: int) -> Rgb:
    """Panels in rows of so many, on white."""
    rows = [panels[i : i + columns] for i in range(0, len(panels), columns)]
    width = PANEL_PX * min(columns, len(panels))
    heights = [max(p.shape[0] for p in row) for row in rows]
    page = np.full((sum(heights), width, 3), PAPER, np.uint8)
    top = 0
    for row, height in zip(rows, heights, strict=True):
        for i, one in enumerate(row):
            page[top : top + one.shape[0], i * PANEL_PX : (i + 1) * PANEL_PX] = one
        top += height
    return page


def to_rgb(image: Image) -> Rgb:
    """An image stretched to 8 bit RGB, dark scenes brightened so that one sees the pattern."""
    top = max(float(np.quantile(grey(image), 0.995)), 1.0)
    bright = np.clip(image.astype(np.float32) / top, 0, 1) ** 0.6
    eight = np.rint(255 * bright).astype(np.uint8)
    return eight if eight.ndim == 3 else np.repeat(eight[..., None], 3, axis=2)


def thumbnail(image: Image, width_px: int = 480) -> Rgb:
    """An image small enough for a page, brightened so that one sees what is on it."""
    factor = min(1.0, width_px / image.shape[1])
    return np.asarray(
        cv2.resize(to_rgb(image), None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA), np.uint8
    )
