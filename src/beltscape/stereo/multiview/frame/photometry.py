"""Grey levels of one frame, made alike: one channel, one gain, and how noisy they are."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import Image

WINDOW_PX = 7
"""Radius of the window in which levels are normalised."""
_FULL = 255.0
"""Levels are 8-bit counts, whatever the images' depth."""
_QUANTISATION = 1.0 / np.sqrt(12.0)
_GAIN = (0.5, 2.0)
"""A camera is not brightened or darkened more than this."""
_QUIET = 20.0
"""Percentile of the blocks that are taken for the image's quiet parts."""
_BLOCK_PX = 16
_BRIGHTEST = 8.0
"""Bright places may be so many times as noisy as quiet ones."""
_LAPLACIAN = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)


def compute_grey_levels(images: Mapping[str, Image], core: str) -> dict[str, NDArray[np.float32]]:
    """(H, W) float32 levels of every camera in 8-bit counts, with the core's contrast.

    Colour channels are weighted by their contrast over all cameras, which for noise alike in all of them is the best
    single image of a coloured pattern.
    """
    weights = _channel_weights([image for image in images.values() if image.ndim == 3])
    levels = {name: _levels(image, weights) for name, image in images.items()}
    contrast = {name: float(level.std()) for name, level in levels.items()}
    gains = {
        name: np.clip(contrast[core] / contrast[name], *_GAIN) if contrast[name] else 1 for name in levels
    }
    return {name: level * np.float32(gains[name]) for name, level in levels.items()}


def noise_variance(level: NDArray[np.float32]) -> float:
    """Variance of the noise, levels², seen in the quietest fifth of an image; at least that of 8 bits.

    References
    ----------
    Immerkær, Fast noise variance estimation, CVIU 64(2), 1996, doi:10.1006/cviu.1996.0060.
    """
    edges = np.abs(cv2.filter2D(level, -1, _LAPLACIAN))
    size = (max(1, level.shape[1] // _BLOCK_PX), max(1, level.shape[0] // _BLOCK_PX))
    blocks = cv2.resize(edges, size, interpolation=cv2.INTER_AREA)
    sigma = float(np.percentile(blocks, _QUIET)) * np.sqrt(np.pi / 2) / 6
    return max(sigma, _QUANTISATION) ** 2


def local_mean(level: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H, W) float32 mean of a window of `WINDOW_PX` about each pixel."""
    size = (2 * WINDOW_PX + 1, 2 * WINDOW_PX + 1)
    return np.asarray(cv2.blur(level, size, borderType=cv2.BORDER_REPLICATE), np.float32)


def local_variance(level: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H, W) float32 variance in that window, levels²."""
    return local_moments(level)[1]


def local_moments(level: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(H, W) mean and (H, W) variance, levels², in that window."""
    mean = local_mean(level)
    return mean, np.maximum(local_mean(level * level) - mean * mean, 0)


def texture_over_noise(level: NDArray[np.float32], noise: float, side: int) -> NDArray[np.float32]:
    """(H, W) variance of the levels in windows of ``side`` px over that of noise alone.

    What a plane in the levels explains counts for nothing: even shading tells no place from another. The noise of
    bright places is greater than ``noise``, the quiet ones'; it is seen in what no smooth image holds.
    """
    reach = np.arange(side, dtype=np.float32) - side // 2
    even, slope = np.full(side, 1 / side, np.float32), reach / np.square(reach).sum()
    mean, square = (
        cv2.blur(x, (side, side), borderType=cv2.BORDER_REPLICATE) for x in (level, level * level)
    )
    across, down = (
        cv2.sepFilter2D(level, cv2.CV_32F, *kernels, borderType=cv2.BORDER_REPLICATE)
        for kernels in ((slope, even), (even, slope))
    )
    texture = square - mean * mean - (across * across + down * down) * np.square(reach).mean()
    rough = local_mean(np.abs(cv2.filter2D(level, -1, _LAPLACIAN))) * np.float32(np.sqrt(np.pi / 2) / 6)
    return np.asarray(texture / np.clip(rough * rough, noise / _BRIGHTEST, noise * _BRIGHTEST), np.float32)


def _channel_weights(images: list[Image]) -> NDArray[np.float32]:
    if not images:
        return np.full(3, 1 / 3, np.float32)
    contrast = np.mean([cv2.meanStdDev(_thinned(image))[1].ravel() for image in images], axis=0)
    total = float(contrast.sum())
    return (contrast / total if total > 0 else np.full(3, 1 / 3)).astype(np.float32)


def _thinned(image: Image) -> NDArray[np.integer]:
    return np.ascontiguousarray(image[::4, ::4, :3])


def _levels(image: Image, weights: NDArray[np.float32]) -> NDArray[np.float32]:
    scale = np.float32(_FULL / np.iinfo(image.dtype).max)
    if image.ndim == 2:
        return image.astype(np.float32) * scale
    # cv2.transform mixes the channels of 8 and 16 bit images without a float copy of all three
    mixed = cv2.transform(image[..., :3].astype(np.float32), (weights * scale)[None])
    return np.ascontiguousarray(mixed, dtype=np.float32)
