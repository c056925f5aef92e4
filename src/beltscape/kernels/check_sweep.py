"""What the plane sweep and the aggregation are given, checked once at the wrapper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.check import float32, sampled_images

WORST = 120
"""The cost of a dissimilarity of 1; costs above it count as this."""

LEAST_PLANES, MOST_PLANES = 4, 4096
"""From 4 on every plane has one that is not its neighbour."""

LARGEST_JUMP = 8000
"""Eight paths of at most this and a cost fit 16 bits."""


@dataclass(frozen=True, slots=True)
class SweepInput:
    """A core image, its auxiliaries and the planes between them."""

    core: NDArray[np.float32]
    """(H, W) grey levels."""
    images: list[NDArray[np.float32]]
    """n of (h, w) grey levels, each at least 2 × 2."""
    views: NDArray[np.float32]
    """(n, 21), see `beltscape.kernels.reference.view.see`."""
    first: float
    step: float
    planes: int
    floor: float
    rows: tuple[int, int]
    best: int
    """How many views are averaged; at most n."""


def sweep_input(
    core: NDArray[np.floating],
    images: Sequence[NDArray[np.floating]],
    views: NDArray[np.floating],
    first: float,
    step: float,
    planes: int,
    floor: float,
    *,
    rows: tuple[int, int] | None,
    best: int,
) -> SweepInput:
    """The input of `sweep` as the kernels take it, or KernelError; without ``rows`` all of them."""
    core = float32("core", core, ("H", "W"))
    if not images:
        raise KernelError("a sweep needs at least one auxiliary image")
    images = sampled_images(images)
    views = float32("views", views, (len(images), 21))
    height = core.shape[0]
    rows = rows or (0, height)
    if not 0 <= rows[0] < rows[1] <= height:
        raise KernelError(f"rows must lie within (0, {height}), not {rows}")
    if not LEAST_PLANES <= planes <= MOST_PLANES:
        raise KernelError(f"planes must be {LEAST_PLANES} to {MOST_PLANES}, not {planes}")
    if not floor > 0:
        raise KernelError(f"floor must be positive, not {floor}")
    if not best >= 1:
        raise KernelError(f"best must be at least 1, not {best}")
    return SweepInput(core, images, views, first, step, planes, floor, rows, min(best, len(images)))


def jumps(small_jump: int, large_jump: int) -> tuple[int, int]:
    """Both as they are, or KernelError."""
    if not 0 <= small_jump <= large_jump <= LARGEST_JUMP:
        raise KernelError(
            f"jumps must be 0 <= small_jump <= large_jump <= {LARGEST_JUMP}, not {small_jump} and {large_jump}"
        )
    return small_jump, large_jump


def costs(cost: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Contiguous (rows, W, D) uint8 with a number of planes D that aggregation takes, or KernelError."""
    fits = cost.ndim == 3 and cost.dtype == np.uint8 and min(cost.shape) > 0
    if not fits or not LEAST_PLANES <= cost.shape[2] <= MOST_PLANES:
        raise KernelError(
            f"cost must be uint8 (rows, W, D) with D from {LEAST_PLANES} to {MOST_PLANES}, "
            f"not {cost.dtype} {cost.shape}"
        )
    return np.ascontiguousarray(cost)
