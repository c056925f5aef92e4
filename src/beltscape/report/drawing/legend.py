"""Colour scales for values, and their legends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from threading import Lock
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Rgb = NDArray[np.uint8]
Color = tuple[int, int, int]

PAPER: Color = (255, 255, 255)
"""Colour behind titles and legends."""
INK: Color = (52, 58, 64)
"""Colour of titles."""
QUIET: Color = (134, 142, 150)
"""Colour of notes, ticks and missing values."""
LEGEND_PX = 50
"""Height of a legend."""
_BAR_PX = 12
"""Height of the ramp and of the patches."""
_BAR = slice(8, 8 + _BAR_PX)
"""Rows of the ramp and of the patches."""
_STEPS = 4
"""Smallest number of intervals between ticks."""
_WEIGHT = 400
"""Weight of the typeface: regular, as in CSS."""
_PATCH_PX = 16
"""Width of a patch."""


def _interpolate_colors(*anchors: Color) -> Rgb:
    """Return a colour map (256, 3) interpolated between evenly spaced colours."""
    where = np.linspace(0, 1, len(anchors))
    channels = np.array(anchors, np.float64).T
    ramps: list[NDArray[np.float64]] = [np.interp(np.linspace(0, 1, 256), where, c) for c in channels]
    return np.rint(ramps).T.astype(np.uint8)


def _opencv_colormap(name: int) -> Rgb:
    ramp = np.arange(256, dtype=np.uint8)[:, None]
    return np.ascontiguousarray(np.asarray(cv2.applyColorMap(ramp, name))[:, 0, ::-1], np.uint8)


HEIGHT = _interpolate_colors(
    (1, 25, 89), (16, 63, 96), (28, 90, 98), (60, 109, 86), (104, 123, 62), (157, 137, 43), (210, 147, 67),
    (248, 161, 123), (253, 183, 188), (250, 204, 250),
)  # fmt: skip
"""(256, 3) for heights and sizes, low dark, high bright: the batlow map of Crameri (doi:10.5281/zenodo.1243862),
perceptually uniform and safe for colour blindness."""
NEAR_TO_FAR = HEIGHT[:24:-1]
"""(231, 3) for depths, near bright; the dark end is cut off so that it can be shaded."""
DIFFERENCE = _interpolate_colors((23, 78, 166), (250, 250, 250), (178, 24, 43))
"""(256, 3) blue below, white at and red above the middle."""
UNCERTAINTY = _opencv_colormap(cv2.COLORMAP_VIRIDIS)
"""(256, 3) for σ and absolute errors, from small (dark, certain) to large (bright, uncertain)."""
CERTAINTY = np.ascontiguousarray(UNCERTAINTY[::-1])
"""(256, 3) for confidence, views and coverage, from low (bright, uncertain) to high (dark, certain)."""
DARK_IS_CERTAIN = "dark: sure, bright: unsure"


_drawing = Lock()
"""OpenCV's typeface keeps its size between calls: two threads at a time would draw with each other's."""


@dataclass(frozen=True, slots=True, eq=False)
class Scale:
    """A linear or logarithmic colour scale between two values; values beyond have the end's colour."""

    low: float
    high: float
    colormap: Rgb
    """(n, 3) RGB, n up to 256."""
    log: bool = False
    label: str = ""
    """Text of the legend."""
    kind: str = "scale"

    def to_rgb(self, values: NDArray[np.floating]) -> Rgb:
        """Return the colours (..., 3) RGB of values (...); NaN grey."""
        with np.errstate(invalid="ignore", divide="ignore"):
            share = self._share(values.astype(np.float32))
        valid = ~np.isnan(share)
        entry = np.rint((len(self.colormap) - 1) * np.where(valid, np.clip(share, 0, 1), 0)).astype(np.uint8)
        image = self.colormap.take(entry, axis=0)
        image[~valid] = QUIET
        return image

    def legend(self, width_px: int) -> Rgb:
        """Draw the legend, (LEGEND_PX, width, 3): a ramp with ticks at round values."""
        image = _paper(width_px)
        image[_BAR] = self.colormap[np.linspace(0, len(self.colormap) - 1, width_px).astype(int)]
        for share, text in self.marks():
            u = round(share * (width_px - 1))
            image[_BAR.stop : _BAR.stop + 5, max(u - 1, 0) : u + 1] = QUIET
            left = min(max(u - measure_text(text, 13) // 2, 0), width_px - measure_text(text, 13))
            draw_text(image, text, (left, _BAR.stop + 20), 13)
        return image

    def marks(self, steps: int = _STEPS) -> list[tuple[float, str]]:
        """Return the ticks as shares of the scale, with their texts."""
        ticks = self.ticks(steps)
        shares = self._share(np.array(ticks, np.float32))
        return [
            (float(np.clip(share, 0, 1)), f"{value:.6g}".replace("-", "−"))
            for share, value in zip(shares, ticks, strict=True)
        ]

    def ticks(self, steps: int = _STEPS) -> list[float]:
        """Return round values within the scale, about ``steps`` to three times as many."""
        if not self.log:
            step = round_below((self.high - self.low) / steps)
            first, last = float(np.ceil(self.low / step - 1e-6)), float(np.floor(self.high / step + 1e-6))
            counts = np.arange(first, last + 1)
            return [float(np.round(n * step, 9) + 0.0) for n in counts]  # adding 0 makes 0 of −0
        decades = range(int(np.floor(np.log10(self.low))), int(np.ceil(np.log10(self.high))) + 1)
        for digits in ((1, 2, 5), (1,)):
            ticks = [d * 10.0**n for n in decades for d in digits]
            ticks = [t for t in ticks if self.low * 0.999 <= t <= self.high * 1.001]
            if len(ticks) <= 3 * steps:
                break
        return ticks

    def _share(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        low, high = (np.log(self.low), np.log(self.high)) if self.log else (self.low, self.high)
        return ((np.log(values) if self.log else values) - np.float32(low)) / np.float32(high - low)


@dataclass(frozen=True, slots=True)
class Swatches:
    """A legend with one colour per word."""

    entries: Sequence[tuple[str, Color]]
    kind: str = "swatches"

    def legend(self, width_px: int) -> Rgb:
        """Draw the legend, (LEGEND_PX, width, 3): a patch before each word."""
        image, left = _paper(width_px), 0
        for text, color in self.entries:
            image[_BAR.start - 2 : _BAR.stop + 2, left : left + _PATCH_PX] = color
            draw_text(image, text, (left + _PATCH_PX + 7, _BAR.stop - 1), 14)
            left += self._step(text)
        return image

    @property
    def width_px(self) -> int:
        """Width of the legend."""
        return sum(self._step(text) for text, _ in self.entries)

    @staticmethod
    def _step(text: str) -> int:
        return _PATCH_PX + 7 + measure_text(text, 14) + 20


def draw_scale_with_key(scale: Scale, key: Swatches, width_px: int) -> Rgb:
    """Draw a scale with the colours of missing values to its right, (LEGEND_PX, width, 3)."""
    ramp = scale.legend(width_px - key.width_px - _PATCH_PX)
    return np.concatenate([ramp, _paper(_PATCH_PX), key.legend(key.width_px)], axis=1)


def round_above(value: float) -> float:
    """Return the smallest of …, 0.5, 1, 2, 5, 10, 20, … that is not below a positive value."""
    decade = 10.0 ** np.floor(np.log10(value))
    return float(decade * next((d for d in (1, 2, 5) if d * decade >= value * (1 - 1e-9)), 10))


def round_below(value: float) -> float:
    """Return the largest of …, 0.5, 1, 2, 5, 10, 20, … that is not above a positive value."""
    return 1 / round_above(1 / value)


def draw_text(image: Rgb, text: str, left_base: tuple[int, int], size: int, color: Color = INK) -> None:
    """Draw text into an image; the position is the left end of its base line, px."""
    with _drawing:
        cv2.putText(image, text, left_base, color, _font(), size, _WEIGHT)


def measure_text(text: str, size: int) -> int:
    """Return the width of a text, px."""
    with _drawing:
        return int(cv2.getTextSize((0, 0), text, (0, 0), _font(), size, _WEIGHT)[2])


def _paper(width_px: int) -> Rgb:
    return np.full((LEGEND_PX, width_px, 3), PAPER, np.uint8)


@cache
def _font() -> Any:
    return cv2.FontFace("sans")
