"""What the kernels of rivals are given, checked once at the wrapper."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.check import flags, float32, sampled_images

MOST_REACH = 1000


class RivalsInput(NamedTuple):
    """A surface, who may hand it on, and to which pixels."""

    surface: list[NDArray[np.float32]]
    """s, slope_u, slope_v, each (H, W)."""
    trusted: NDArray[np.uint8]
    u: NDArray[np.float32]
    v: NDArray[np.float32]
    reach: int
    same: float


class LikenessesInput(NamedTuple):
    """Planes at pixels, and what the cameras see."""

    u: NDArray[np.float32]
    v: NDArray[np.float32]
    planes: list[NDArray[np.float32]]
    """s, slope_u, slope_v, each (C, N)."""
    core: NDArray[np.float32]
    variance: NDArray[np.float32]
    images: list[NDArray[np.float32]]
    views: NDArray[np.float32]
    buffers: list[NDArray[np.float32]]
    gains: list[NDArray[np.float32]]
    tolerance: float


def rivals_input(
    s: NDArray[np.floating],
    slope_u: NDArray[np.floating],
    slope_v: NDArray[np.floating],
    trusted: NDArray[np.uint8],
    u: NDArray[np.integer],
    v: NDArray[np.integer],
    reach: int,
    same: float,
) -> RivalsInput:
    """The input of `rivals` as the kernels take it, or KernelError."""
    s = float32("s", s, ("H", "W"))
    if not 1 <= reach <= MOST_REACH:
        raise KernelError(f"reach must be 1 to {MOST_REACH} steps, not {reach}")
    if not 0 < same < np.inf:
        raise KernelError(f"same must be positive, not {same}")
    slopes = float32("slope_u", slope_u, s.shape), float32("slope_v", slope_v, s.shape)
    return RivalsInput([s, *slopes], flags("trusted", trusted, s.shape), *pixels(u, v, s.shape), reach, same)


def likenesses_input(
    u: NDArray[np.integer],
    v: NDArray[np.integer],
    planes: tuple[NDArray[np.floating], ...],
    *,
    core: NDArray[np.floating],
    variance: NDArray[np.floating],
    images: Sequence[NDArray[np.floating]],
    views: NDArray[np.floating],
    buffers: Sequence[NDArray[np.floating]],
    gains: Sequence[NDArray[np.floating]],
    tolerance: float,
) -> LikenessesInput:
    """The input of `likenesses` as the kernels take it, or KernelError."""
    core = float32("core", core, ("H", "W"))
    columns, rows = pixels(u, v, core.shape)
    first = float32("s", planes[0], ("C", len(columns)))
    images = sampled_images(images)
    for name, given in (("buffers", buffers), ("gains", gains)):
        if len(given) != len(images):
            raise KernelError(f"{name} must be {len(images)}, as the images are, not {len(given)}")
    if not 0 <= tolerance < np.inf:
        raise KernelError(f"tolerance must not be negative, not {tolerance}")
    return LikenessesInput(
        columns,
        rows,
        [first, *(float32("slopes", plane, first.shape) for plane in planes[1:])],
        core,
        float32("variance", variance, core.shape),
        images,
        float32("views", views, (len(images), 21)),
        [float32(f"buffers[{i}]", b, images[i].shape) for i, b in enumerate(buffers)],
        [float32(f"gains[{i}]", gain, core.shape) for i, gain in enumerate(gains)],
        tolerance,
    )


def pixels(
    u: NDArray[np.integer], v: NDArray[np.integer], shape: tuple[int, ...]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(N,) columns and rows within (H, W) as the kernels take them, or KernelError."""
    for name, index, size in (("u", u, shape[1]), ("v", v, shape[0])):
        if index.ndim != 1 or not len(index) or len(index) != len(u) or index.dtype.kind not in "iu":
            raise KernelError(f"{name} must be ({len(u)},) integers, not {index.dtype} {index.shape}")
        if index.min() < 0 or index.max() >= size:
            raise KernelError(f"{name} must be 0 to {size - 1}, not {index.min()} to {index.max()}")
    return np.asarray(u, np.float32), np.asarray(v, np.float32)
