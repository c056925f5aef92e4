"""The references of the kernels of a frame's images; OpenCV's in `opencv_planes` are besides."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Array
from beltscape.kernels.photometry import GreyImage, ImageInput, LevelsInput, SharpnessInput

_MOST_LEVEL = 255.0
"""Levels are in counts of 8 bits."""


def measure_contrast(given: ImageInput) -> tuple[NDArray[np.float32]]:
    """Return (1,) the standard deviation."""
    return (np.asarray([_find_levels(given.image).std()], np.float32),)


def make_levels(given: LevelsInput) -> tuple[NDArray[np.float32]]:
    """Return the levels (H, W)."""
    return (_find_levels(given.image) * np.float32(given.gain),)


def _find_levels(image: GreyImage) -> NDArray[np.float32]:
    return image.astype(np.float32) * np.float32(_MOST_LEVEL / np.iinfo(image.dtype).max)


def measure_sharpness(given: SharpnessInput) -> tuple[Array]:
    """Return (2,) the variances."""
    image = np.asarray(given.image, np.float64)
    blurred = [
        _blur(_blur(image, half[: radius + 1]).T, half[: radius + 1]).T
        for half, radius in zip(given.weights, given.radii, strict=True)
    ]
    return (np.array([np.var(blurred[0] - blurred[1]), np.var(blurred[1] - blurred[2])], np.float64),)


def _blur(image: Array, half: NDArray[np.float32]) -> Array:
    """Return an image (H, W) blurred along its columns."""
    radius = len(half) - 1
    padded = np.pad(image, ((radius, radius), (0, 0)), mode="reflect")
    return np.asarray(
        sum(half[abs(i)] * padded[radius + i : radius + i + len(image)] for i in range(-radius, radius + 1)),
        np.float64,
    )
