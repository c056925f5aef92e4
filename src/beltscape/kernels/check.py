"""Shapes are checked once, at the public wrapper; behind it code trusts its input."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError


def triangulation_input(
    projections: NDArray[np.float64], pixels: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Contiguous float64 (n, 3, 4) projections and (n, N, 2) pixels, or KernelError."""
    projections = np.ascontiguousarray(projections, dtype=np.float64)
    pixels = np.ascontiguousarray(pixels, dtype=np.float64)
    if projections.ndim != 3 or projections.shape[1:] != (3, 4):
        raise KernelError(f"projections must have the shape (n, 3, 4), not {projections.shape}")
    if pixels.ndim != 3 or pixels.shape[2] != 2 or pixels.shape[0] != projections.shape[0]:
        raise KernelError(
            f"pixels must have the shape ({projections.shape[0]}, N, 2) for {projections.shape[0]} cameras, "
            f"not {pixels.shape}"
        )
    return projections, pixels


def float32(name: str, array: NDArray[np.floating], shape: tuple[int | str, ...]) -> NDArray[np.float32]:
    """The array as contiguous float32 of a shape, or KernelError; a letter in ``shape`` is any size >= 1."""
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
    """Contiguous uint8 of a shape, from that or bool, or KernelError."""
    if array.shape != shape or array.dtype not in (np.uint8, np.bool_):
        raise KernelError(f"{name} must be uint8 or bool {shape}, not {array.dtype} {array.shape}")
    return np.ascontiguousarray(array).view(np.uint8)


def spline(coefficients: NDArray[np.floating]) -> NDArray[np.float32]:
    """Contiguous float32 coefficients (h, w) of an image of at least 4 × 4, or KernelError."""
    coefficients = float32("coefficients", coefficients, ("h", "w"))
    if min(coefficients.shape) < 4:
        raise KernelError(f"coefficients must be of at least 4 × 4 pixels, not {coefficients.shape}")
    return coefficients


def sampled_images(images: Sequence[NDArray[np.floating]]) -> list[NDArray[np.float32]]:
    """Contiguous float32 images (h, w) of at least 2 × 2, as bilinear sampling needs, or KernelError."""
    checked = [float32(f"images[{i}]", image, ("h", "w")) for i, image in enumerate(images)]
    for i, image in enumerate(checked):
        if min(image.shape) < 2:
            raise KernelError(f"images[{i}] must be of at least 2 × 2 pixels, not {image.shape}")
    return checked


def image_sizes(sizes: Sequence[tuple[int, int]]) -> Sequence[tuple[int, int]]:
    """The (width, height) as they are, or KernelError."""
    for size in sizes:
        if min(size) < 1:
            raise KernelError(f"an image's size must be positive, not {size}")
    return sizes
