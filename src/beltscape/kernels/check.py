"""Shapes are checked once, at the public wrapper; behind it code trusts its input."""

from __future__ import annotations

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
