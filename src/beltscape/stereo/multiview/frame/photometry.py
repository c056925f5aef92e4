"""Grey levels of a frame's images, equalised in channel and contrast, and the noise in them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import Image
from beltscape.stereo.multiview.frame.parallel import run_parallel

WINDOW_PX = 7
"""Radius of the window in which levels are normalised."""
_FULL = 255.0
"""Levels are given in 8-bit counts for images of any bit depth."""
_QUANTISATION = 1.0 / np.sqrt(12.0)
"""σ of rounding to whole levels."""
_GAIN = (0.5, 2.0)
"""Range of the gain by which a camera's levels are multiplied."""
_QUIET = 20.0
"""Percentile of the blocks that represents the image's parts of least texture."""
_BLOCK_PX = 16
"""Side of the blocks in which the noise is estimated."""
_BRIGHTEST = 8.0
"""Largest ratio of the noise variance of a bright region to that of the quietest blocks."""
_LAPLACIAN = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
"""Difference of two Laplacians, blind to planes of brightness (Immerkær 1996)."""


def compute_grey_levels(
    images: Mapping[str, Image], core: str, threads: int = 1
) -> dict[str, NDArray[np.float32]]:
    """Return (H, W) float32 levels of every camera in 8-bit counts, with the contrast of the core.

    Colour channels are weighted by their contrast over all cameras. Where the noise of all channels is the same, this
    gives the best single image of a coloured pattern.
    """
    weights = _compute_channel_weights([image for image in images.values() if image.ndim == 3])

    def compute_level(image: Image) -> tuple[NDArray[np.float32], float]:
        level = _compute_levels(image, weights)
        return level, float(level.std())

    jobs = [partial(compute_level, image) for image in images.values()]
    found = dict(zip(images, run_parallel(jobs, threads), strict=True))
    _, core_contrast = found[core]
    gains = {
        name: np.clip(core_contrast / contrast, *_GAIN) if contrast else 1
        for name, (_, contrast) in found.items()
    }
    return {name: level * np.float32(gains[name]) for name, (level, _) in found.items()}


def estimate_noise_variance(level: NDArray[np.float32]) -> float:
    """Return the noise variance, levels², of the least textured fifth of an image; at least that of 8 bits.

    References
    ----------
    Immerkær, Fast noise variance estimation, CVIU 64(2), 1996, doi:10.1006/cviu.1996.0060.
    """
    edges = np.abs(cv2.filter2D(level, -1, _LAPLACIAN))
    size = (max(1, level.shape[1] // _BLOCK_PX), max(1, level.shape[0] // _BLOCK_PX))
    blocks = cv2.resize(edges, size, interpolation=cv2.INTER_AREA)
    sigma = float(np.percentile(blocks, _QUIET)) * np.sqrt(np.pi / 2) / 6
    return max(sigma, _QUANTISATION) ** 2


def compute_local_mean(level: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the (H, W) float32 mean within `WINDOW_PX` around each pixel."""
    size = (2 * WINDOW_PX + 1, 2 * WINDOW_PX + 1)
    return np.asarray(cv2.blur(level, size, borderType=cv2.BORDER_REPLICATE), np.float32)


def compute_local_variance(level: NDArray[np.float32], stride: int = 1) -> NDArray[np.float32]:
    """Return the float32 variance, levels², in the window of `compute_local_mean` of every ``stride``-th pixel."""
    return compute_local_moments(level, stride)[1]


def compute_local_moments(
    level: NDArray[np.float32], stride: int = 1
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return mean and variance, levels², in the window of `compute_local_mean` of every ``stride``-th pixel."""
    mean, square = (compute_local_mean(x)[::stride, ::stride] for x in (level, level * level))
    return mean, _compute_variance(mean, square)


def compute_box_moments(
    image: NDArray[np.float32], box: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the (H, W) mean and (H, W) variance in windows of (width, height) ``box``."""
    mean, square = (np.asarray(cv2.blur(x, box), np.float32) for x in (image, image * image))
    return mean, _compute_variance(mean, square)


def _compute_variance(mean: NDArray[np.float32], square: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the variance of values with a mean and a mean square, which it overwrites."""
    square -= mean * mean
    return np.maximum(square, 0, out=square)


def compute_texture_ratio(level: NDArray[np.float32], noise: float, side: int) -> NDArray[np.float32]:
    """Return the (H, W) variance of the levels in windows of ``side`` px over that of noise.

    The variance that a plane explains is subtracted: linear shading does not identify a pixel. Bright regions are
    noisier than ``noise``, the variance of the quietest blocks; their noise is estimated from the Laplacian.
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
    edges = cv2.filter2D(level, -1, _LAPLACIAN)
    rough = compute_local_mean(np.abs(edges, out=edges)) * np.float32(np.sqrt(np.pi / 2) / 6)
    rough *= rough
    return np.asarray(texture / rough.clip(noise / _BRIGHTEST, noise * _BRIGHTEST, out=rough), np.float32)


def _compute_channel_weights(images: list[Image]) -> NDArray[np.float32]:
    if not images:
        return np.full(3, 1 / 3, np.float32)
    contrast = np.mean([cv2.meanStdDev(_subsample(image))[1].ravel() for image in images], axis=0)
    total = float(contrast.sum())
    return (contrast / total if total > 0 else np.full(3, 1 / 3)).astype(np.float32)


def _subsample(image: Image) -> NDArray[np.integer]:
    return np.ascontiguousarray(image[::4, ::4, :3])


def _compute_levels(image: Image, weights: NDArray[np.float32]) -> NDArray[np.float32]:
    scale = np.float32(_FULL / np.iinfo(image.dtype).max)
    if image.ndim == 2:
        return image.astype(np.float32) * scale
    # cv2.transform mixes the channels of 8 and 16 bit images without a float copy of all three
    mixed = cv2.transform(image[..., :3].astype(np.float32), (weights * scale)[None])
    return np.ascontiguousarray(mixed, dtype=np.float32)
