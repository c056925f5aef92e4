"""What the view from above takes, checked once at the wrapper."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.check import float32


class Checked(NamedTuple):
    """Contiguous arrays, of shapes that fit each other."""

    depth: NDArray[np.float32]
    sigma: NDArray[np.float32]
    use: NDArray[np.bool_]
    grid_from_pixel: NDArray[np.float64]
    step: float


def top_view_input(
    depth: NDArray[np.floating],
    sigma: NDArray[np.floating],
    use: NDArray[np.bool_],
    grid_from_pixel: NDArray[np.floating],
    step: float,
    shape: tuple[int, int],
) -> Checked:
    """The arrays as the kernels take them, or KernelError."""
    depth = float32("depth", depth, ("H", "W"))
    sigma = float32("sigma", sigma, depth.shape)
    use = np.ascontiguousarray(use, dtype=bool)
    if use.shape != depth.shape:
        raise KernelError(f"use must have the shape {depth.shape}, not {use.shape}")
    grid_from_pixel = np.ascontiguousarray(grid_from_pixel, dtype=np.float64)
    if grid_from_pixel.shape != (3, 4):
        raise KernelError(f"grid_from_pixel must have the shape (3, 4), not {grid_from_pixel.shape}")
    if not step >= 0:
        raise KernelError(f"step must be at least 0, not {step}")
    if min(shape) < 1:
        raise KernelError(f"the grid's shape must be positive, not {shape}")
    return Checked(depth, sigma, use, grid_from_pixel, step)
