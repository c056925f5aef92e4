"""Helpers for exposure, focus and aperture: histogram, brightness, and sharpness over a camera's image.

Sharpness compares differences of neighbouring pixels with those four pixels apart (RMS): 0 where an image is so
blurred that it only slopes, 1 for white noise. It does not depend on the contrast, rises as focus improves, and is
the same over the image where the lens is focused on the whole belt; at the rim it falls where the aperture is too
wide. Its σ is that of the mean over the four quarters of a tile.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Array
from beltscape.core.frames import Image, saturated_fraction, to_grey
from beltscape.core.translatable_message import get_key, get_values
from beltscape.sources.genicam.health import BRIGHTEST, find_brightness_fault

BINS = 64
"""Bars of a histogram; finer ones are not visible on a phone."""
TILES = (8, 6)
"""Tiles across and down an image."""
FAR_PX = 4
"""Distance of the pixels that neighbouring ones are compared with: about the dot of a speckle pattern."""
LEAST_CONTRAST = 0.012
"""RMS difference of pixels `FAR_PX` apart, as a share of the range, from which a tile has texture: 3 of 255 levels,
three times the noise of a camera. Chosen."""


@dataclass(frozen=True, slots=True, eq=False)
class SharpnessMap:
    """Sharpness of an image in `TILES`; NaN where there is too little texture."""

    values: Array
    """(rows, columns), 0 … 1."""
    sigmas: Array
    """(rows, columns) one standard deviation."""

    @property
    def median(self) -> float:
        """Return the median of the tiles with texture; NaN without any."""
        known = self.values[np.isfinite(self.values)]
        return float(np.median(known)) if known.size else float("nan")

    @property
    def evenness(self) -> float:
        """Return the least over the greatest tile's sharpness; NaN without texture."""
        known = self.values[np.isfinite(self.values)]
        return float(known.min() / known.max()) if known.size else float("nan")


@dataclass(frozen=True, slots=True, eq=False)
class OpticsReport:
    """What an image shows of exposure and focus."""

    size_px: tuple[int, int]
    """Width and height."""
    histogram: NDArray[np.int64]
    """(BINS,) pixels by grey level, dark to bright."""
    bright: float
    """Level of the brightest pixels, as a share of the range."""
    saturated: float
    """Share of saturated pixels."""
    fault: str
    """Why the brightness is wrong (`find_brightness_fault`); empty: it is not."""
    sharpness: SharpnessMap

    def document(self) -> dict[str, object]:
        """Return plain values for JSON; the fault by its key and values."""
        return {
            "size_px": self.size_px,
            "histogram": self.histogram,
            "bright": self.bright,
            "saturated": self.saturated,
            "fault": get_key(self.fault) if self.fault else "",
            "fault_values": get_values(self.fault) if self.fault else {},
            "sharpness": self.sharpness.values,
            "sharpness_sigma": self.sharpness.sigmas,
            "sharpness_median": self.sharpness.median,
            "evenness": self.sharpness.evenness,
        }


def assess_optics(image: Image) -> OpticsReport:
    """Return what an image (H, W) or (H, W, 3) shows of exposure and focus."""
    top = float(np.iinfo(image.dtype).max)
    grey = to_grey(image) / top
    height, width = grey.shape
    histogram, _ = np.histogram(grey[::2, ::2], bins=BINS, range=(0.0, 1.0))
    return OpticsReport(
        size_px=(width, height),
        histogram=histogram,
        bright=float(np.quantile(grey[::4, ::4], BRIGHTEST)),
        saturated=saturated_fraction(image[::2, ::2]),
        fault=find_brightness_fault(image),
        sharpness=map_sharpness(grey),
    )


def assess_all(images: Mapping[str, Image]) -> dict[str, OpticsReport]:
    """Return the reports of all cameras' images."""
    return {name: assess_optics(image) for name, image in images.items()}


def map_sharpness(grey: NDArray[np.float32]) -> SharpnessMap:
    """Return the sharpness of a grey image (H, W), 0 … 1, in tiles."""
    near = np.square(np.diff(grey, axis=1, append=grey[:, -1:])) + np.square(
        np.diff(grey, axis=0, append=grey[-1:])
    )
    far = np.square(_shift(grey, FAR_PX, 1) - grey) + np.square(_shift(grey, FAR_PX, 0) - grey)
    columns, rows = TILES
    # four quarters of each tile
    energy = _average(near, 2 * columns, 2 * rows), _average(far, 2 * columns, 2 * rows)
    with np.errstate(invalid="ignore", divide="ignore"):
        quarters = _scale(np.sqrt(energy[0] / energy[1]))
        contrast = np.sqrt(_join(energy[1]).mean(axis=-1) / 2)
        values = _scale(np.sqrt(_join(energy[0]).mean(axis=-1) / _join(energy[1]).mean(axis=-1)))
    sigmas = _join(quarters).std(axis=-1, ddof=1) / 2
    has_texture = contrast >= LEAST_CONTRAST
    return SharpnessMap(np.where(has_texture, values, np.nan), np.where(has_texture, sigmas, np.nan))


def _scale(ratio: Array) -> Array:
    """Return the sharpness of a ratio of differences: that of a slope, 1 / FAR_PX, is none."""
    return np.clip((ratio - 1 / FAR_PX) / (1 - 1 / FAR_PX), 0.0, None)


def _shift(grey: NDArray[np.float32], step: int, axis: int) -> NDArray[np.float32]:
    """Return the image moved by ``step`` pixels, its edge repeated."""
    index = np.minimum(np.arange(grey.shape[axis]) + step, grey.shape[axis] - 1)
    return np.take(grey, index, axis=axis)


def _average(energy: NDArray[np.float32], columns: int, rows: int) -> Array:
    """Return the means (rows, columns) over equal parts of the image."""
    v = np.linspace(0, energy.shape[0], rows + 1).astype(int)[:-1]
    u = np.linspace(0, energy.shape[1], columns + 1).astype(int)[:-1]
    sums = np.add.reduceat(np.add.reduceat(energy.astype(np.float64), v, axis=0), u, axis=1)
    counts = np.outer(np.diff([*v, energy.shape[0]]), np.diff([*u, energy.shape[1]]))
    return sums / counts


def _join(quarters: Array) -> Array:
    """Return quarters (2 rows, 2 columns) as (rows, columns, 4)."""
    rows, columns = quarters.shape
    return (
        quarters.reshape(rows // 2, 2, columns // 2, 2)
        .transpose(0, 2, 1, 3)
        .reshape(rows // 2, columns // 2, 4)
    )
