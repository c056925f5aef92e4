"""Statistics of an image on a grid of blocks: level, texture in two bands, saturation, noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Float32Array
from beltscape.core.frames import Image, to_grey
from beltscape.core.statistics import compute_median, compute_quantile

GRID = 32, 40
"""Rows and columns of blocks: about 16 px in an image of 612×512, and the same picture of dirt at any image size."""
_ROWS = 5 * GRID[0]
"""This number of rows is examined, evenly spaced; texture is examined along them."""
_COMPARED_STEP = 4
"""Every fourth row of the examined rows is compared with the image before."""
_FULL = 255.0
"""Full range of the levels: images of more bits are scaled to 8."""
_NARROW_PX, _WIDE_PX = (3, 1), (7, 1)
"""Texture finer than the first box is fine; between the two it is coarse. Projected dots: radius 1 to 3 px."""
_THIRD_DIFFERENCE = np.array([[1, -3, 3, -1]], np.float32)
"""Third difference along a row, in which smooth shading vanishes and noise remains."""
_DIFFERENCE_GAIN = 20.0
"""Sum of the squares of `_THIRD_DIFFERENCE`: its gain of the variance of white noise."""
_QUIET = 0.1
"""Quantile of the blocks that have hardly any texture."""
FINE_NOISE_SHARE, COARSE_NOISE_SHARE = 1 - 1 / 3, 3 * (1 / 3 - 1 / 7) ** 2 + 4 / 7**2
"""Shares of the variance of white noise in the two bands, from the sums of the boxes' squares."""
_SATURATED = 0.98
"""A level from this share of the full range on is saturated; area averages of saturated pixels stay above it."""
_NO_TEXTURE = -10.0
"""Logarithm of the sharpness of an image without any texture."""
_TEXTURED = 0.25
"""Blocks with this share of the coarse texture of the image's most textured quarter are compared."""


@dataclass(frozen=True, slots=True, eq=False)
class ImageStatistics:
    """Statistics of one image; grids are `GRID` float32, levels in counts of 255."""

    level: Float32Array
    """Mean level."""
    fine: Float32Array
    """Variance of fine texture, levels²; its noise is subtracted."""
    coarse: Float32Array
    """Variance of coarse texture, levels²; its noise is subtracted."""
    saturated_share: float
    """Share of saturated pixels."""
    noise: float
    """Variance of the noise in the least textured blocks, levels²."""
    mean_level: float
    """Mean level of the image, at least 0.1."""
    contrast: float
    """Median contrast (root of the texture's variance over the level) of the lit blocks, at least 0.0001."""
    lit_contrast: float
    """Contrast that four fifths of the lit blocks exceed: high only under projected speckle."""
    log_sharpness: float
    """Logarithm of fine over coarse texture in the textured blocks; -10 without texture."""
    shading: float
    """Relative spread of the level between blocks, which a veil reduces but defocus does not; at least 0.0001."""
    signal_to_noise: float
    """Texture of the median lit block over noise."""
    exposure_us: float = 1.0
    """Exposure time of the image; 1 where it never changes, NaN where it is not known."""

    @property
    def amplitude(self) -> Float32Array:
        """Root of the texture's variance, `GRID`, levels: under speckle the amplitude of the projected light."""
        return np.asarray(np.sqrt(self.fine + self.coarse), np.float32)

    @property
    def contrasts(self) -> Float32Array:
        """Root of the texture's variance over the level, `GRID`."""
        return _compute_contrasts(self.fine + self.coarse, self.level)


@dataclass(frozen=True, slots=True, eq=False)
class ImageSample:
    """What the checks take from one image; another process may have computed it."""

    statistics: ImageStatistics
    rows: Float32Array
    """(40, W) levels of every fourth of the examined rows, by which an image is compared with the one before."""


def sample_images(images: Mapping[str, Image]) -> dict[str, ImageSample]:
    """Return what the checks take from each camera's image."""
    samples: dict[str, ImageSample] = {}
    for name, image in images.items():
        levels = compute_levels(image)
        rows = np.ascontiguousarray(levels[::_COMPARED_STEP])
        samples[name] = ImageSample(compute_statistics(image, levels), rows)
    return samples


def _choose_rows(image: Image) -> NDArray[np.intp]:
    """Return the indices of evenly spaced rows of an image."""
    return ((np.arange(_ROWS) + 0.5) * len(image) / _ROWS).astype(np.intp)


def compute_levels(image: Image) -> Float32Array:
    """Return the grey levels (160, W) of evenly spaced rows of an image, in counts of 255."""
    grey = to_grey(image[_choose_rows(image)])
    return grey if image.dtype == np.uint8 else grey * np.float32(_FULL / np.iinfo(image.dtype).max)


def compute_statistics(image: Image, levels: Float32Array) -> ImageStatistics:
    """Return the statistics of an image and the result of `compute_levels` of it."""
    narrow, wide = cv2.blur(levels, _NARROW_PX), cv2.blur(levels, _WIDE_PX)
    edges = np.abs(cv2.filter2D(levels, -1, _THIRD_DIFFERENCE))
    quiet = compute_quantile(average_blocks(edges), _QUIET) * np.sqrt(np.pi / 2)
    noise = max(quiet**2 / _DIFFERENCE_GAIN, 1 / 12)
    level = average_blocks(levels)
    fine = np.maximum(_average_square(levels, narrow) - np.float32(FINE_NOISE_SHARE * noise), 0)
    coarse = np.maximum(_average_square(narrow, wide) - np.float32(COARSE_NOISE_SHARE * noise), 0)
    texture, lit = fine + coarse, level >= 0.5 * compute_median(level)
    contrasts = _compute_contrasts(texture, level)[lit]
    faint, middle = compute_quantile(contrasts, 0.2), compute_median(contrasts)
    low, high = compute_quantile(level, 0.05), compute_quantile(level, 0.95)
    return ImageStatistics(
        level=level,
        fine=fine,
        coarse=coarse,
        saturated_share=_compute_saturated_share(image),
        noise=noise,
        mean_level=max(float(level.mean()), 0.1),
        contrast=max(middle, 1e-4),
        lit_contrast=faint,
        log_sharpness=_compute_log_sharpness(fine, coarse),
        shading=max((high - low) / max(high + low, 0.2), 1e-4),
        signal_to_noise=float(np.sqrt(compute_median(texture[lit]) / noise)),
    )


def _compute_saturated_share(image: Image) -> float:
    """Return the share of pixels of which a channel is saturated, in evenly spaced rows.

    Under coloured light the grey level stays below the limit, while what a channel has seen is lost.
    """
    rows = image[_choose_rows(image)]
    strongest = rows if rows.ndim == 2 else rows.max(axis=2)
    return float(np.mean(strongest >= _SATURATED * np.iinfo(image.dtype).max))


def _compute_contrasts(texture: Float32Array, level: Float32Array) -> Float32Array:
    return np.asarray(np.sqrt(texture) / np.maximum(level, 1), np.float32)


def _compute_log_sharpness(fine: Float32Array, coarse: Float32Array) -> float:
    textured = coarse > _TEXTURED * compute_quantile(coarse, 0.75)
    high, low = float(fine[textured].sum()), float(coarse[textured].sum())
    return float(np.log(max(high, 1e-6) / low)) if low > 0 else _NO_TEXTURE


def compute_block_size(size_px: tuple[int, int]) -> tuple[float, float]:
    """Return width and height, px, of a block in an image of ``size_px`` (width, height)."""
    return float(max(size_px[0] // GRID[1], 1)), size_px[1] / GRID[0]


def average_blocks(values: Float32Array) -> Float32Array:
    """Return the mean of (160, W) values in each block of `GRID`; a rest at the right rim is left out."""
    whole = values[:, : max(values.shape[1] // GRID[1], 1) * GRID[1]]
    return np.asarray(cv2.resize(whole, GRID[::-1], interpolation=cv2.INTER_AREA), np.float32)


def _average_square(one: Float32Array, other: Float32Array) -> Float32Array:
    difference = one - other
    return average_blocks(np.asarray(cv2.multiply(difference, difference), np.float32))


def remove_single_blocks(blocks: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the blocks of `GRID` that belong to a square of 2×2 blocks that are set."""
    squares = blocks[:-1, :-1] & blocks[1:, :-1] & blocks[:-1, 1:] & blocks[1:, 1:]
    kept = np.zeros_like(blocks)
    for rows in (slice(None, -1), slice(1, None)):
        for columns in (slice(None, -1), slice(1, None)):
            kept[rows, columns] |= squares
    return kept


def find_place(blocks: NDArray[np.bool_]) -> tuple[float, float, float, float] | None:
    """Return left, top, right, bottom of the blocks of `GRID` that are set, as shares of the picture; None: none."""
    rows, columns = np.nonzero(blocks)
    if not len(rows):
        return None
    return (
        float(columns.min() / GRID[1]),
        float(rows.min() / GRID[0]),
        float((columns.max() + 1) / GRID[1]),
        float((rows.max() + 1) / GRID[0]),
    )
