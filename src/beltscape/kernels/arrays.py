"""Checks of arrays: shapes and types are checked once, at the kernels' public methods."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import cast

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.resident import ResidentArray

WINDOW_LIMIT = 15
"""Largest radius of a window, px; arrays of the native kernels have this size (``kMaxRadius``)."""
MOST_LAYERS = 8
"""Of a network on a GPU (``kMostLayers`` of networks.cuh)."""


def float32(name: str, array: NDArray[np.floating], shape: tuple[int | str, ...]) -> NDArray[np.float32]:
    """Return the array as contiguous float32 of a shape (a letter: any size >= 1), or raise KernelError."""
    if not (isinstance(array, ResidentArray) and array.dtype == np.float32):
        array = np.ascontiguousarray(array, dtype=np.float32)
    if array.shape == shape:
        return array
    fits = array.ndim == len(shape) and all(
        have == want if isinstance(want, int) else have > 0
        for have, want in zip(array.shape, shape, strict=True)
    )
    if not fits:
        wanted = f"({', '.join(map(str, shape))}{',' if len(shape) == 1 else ''})"
        raise KernelError(f"{name} must have the shape {wanted}, not {array.shape}")
    return array


def flags(name: str, array: NDArray[np.uint8], shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return contiguous uint8 of a shape, from uint8 or bool, or raise KernelError."""
    if array.shape != shape or array.dtype not in (np.dtype(np.uint8), np.dtype(np.bool_)):
        raise KernelError(f"{name} must be uint8 or bool {shape}, not {array.dtype} {array.shape}")
    if isinstance(array, ResidentArray):
        return array.astype(np.uint8, copy=False)
    return np.ascontiguousarray(array).view(np.uint8)


def spline(coefficients: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return contiguous float32 spline coefficients (h, w) of at least 4 × 4, or raise KernelError."""
    coefficients = float32("coefficients", coefficients, ("h", "w"))
    if min(coefficients.shape) < 4:
        raise KernelError(f"coefficients must be of at least 4 × 4 pixels, not {coefficients.shape}")
    return coefficients


def sampled_images(images: Sequence[NDArray[np.floating]]) -> list[NDArray[np.float32]]:
    """Return contiguous float32 images (h, w), at least 2 × 2 for bilinear sampling, or raise KernelError."""
    checked = [float32(f"images[{i}]", image, ("h", "w")) for i, image in enumerate(images)]
    for i, image in enumerate(checked):
        if min(image.shape) < 2:
            raise KernelError(f"images[{i}] must be of at least 2 × 2 pixels, not {image.shape}")
    return checked


def image_sizes(sizes: Sequence[tuple[int, int]]) -> Sequence[tuple[int, int]]:
    """Return the (width, height) as they are, or raise KernelError."""
    for size in sizes:
        if min(size) < 1:
            raise KernelError(f"an image's size must be positive, not {size}")
    return sizes


def pixel_indices(
    u: NDArray[np.integer], v: NDArray[np.integer], shape: tuple[int, ...]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return (N,) columns and rows within (H, W) as float32, or raise KernelError.

    Those on a device are float32 already: `find_pixels` found them in a mask of that shape.
    """
    if isinstance(u, ResidentArray) and isinstance(v, ResidentArray):
        return cast("tuple[NDArray[np.float32], NDArray[np.float32]]", (u, v))
    for name, index, size in (("u", u, shape[1]), ("v", v, shape[0])):
        if index.ndim != 1 or not len(index) or len(index) != len(u) or index.dtype.kind not in "iu":
            raise KernelError(f"{name} must be ({len(u)},) integers, not {index.dtype} {index.shape}")
        if index.view(f"u{index.itemsize}").max() >= size:  # negative numbers are large ones
            raise KernelError(f"{name} must be 0 to {size - 1}, not {index.min()} to {index.max()}")
    return np.asarray(u, np.float32), np.asarray(v, np.float32)


def demand_within(name: str, number: float, low: float, high: float) -> None:
    """Raise KernelError when a number is not finite or not in its bounds; one on a device is not examined."""
    if isinstance(number, ResidentArray):
        return
    if not (np.isfinite(number) and low <= number <= high):
        bounds = "positive" if low < 1e-300 and low else f"at least {low:g}"
        bounds += "" if high == inf else f" and at most {high:g}"
        raise KernelError(f"{name} must be {bounds}, not {number:g}")


CellIndices = tuple[NDArray[np.intp], ...]
"""Rows and columns of cells, (H,) each."""
