"""What of the core's surface an auxiliary sees: the reference of `nearness_buffers` and `visible`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.check import float32, image_sizes
from beltscape.kernels.reference.view import see


def nearness_buffers(
    s: NDArray[np.floating],
    views: NDArray[np.floating],
    sizes: Sequence[tuple[int, int]],
    *,
    threads: int = 0,
) -> list[NDArray[np.float64]]:
    """See `beltscape.kernels.protocol.occlusion`; ``threads`` is ignored here."""
    del threads
    s, views = float32("s", s, ("H", "W")), float32("views", views, (len(sizes), 21))
    return [_buffer(s, view, size) for view, size in zip(views, image_sizes(sizes), strict=True)]


def _buffer(
    s: NDArray[np.floating], view: NDArray[np.floating], size: tuple[int, int]
) -> NDArray[np.float64]:
    width, height = size
    y, x = np.indices(s.shape)
    u, v, nearness = (a[np.isfinite(a)] for a in see(view, x, y, s.astype(np.float64)))
    framed = np.zeros((height + 2, width + 2))  # a pixel all around, for what is seen half outside
    near = (u >= -1) & (u < width) & (v >= -1) & (v < height)
    column, row = np.floor(u[near]).astype(int) + 1, np.floor(v[near]).astype(int) + 1
    for right in (0, 1):
        for down in (0, 1):
            np.maximum.at(framed, (row + down, column + right), nearness[near])
    return framed[1:-1, 1:-1].copy()


def visible(
    s: NDArray[np.floating],
    view: NDArray[np.floating],
    buffer: NDArray[np.floating],
    tolerance: float,
    *,
    threads: int = 0,
) -> NDArray[np.uint8]:
    """See `beltscape.kernels.protocol.occlusion`; ``threads`` is ignored here."""
    del threads
    s, view = float32("s", s, ("H", "W")), float32("view", view, (21,))
    buffer = float32("buffer", buffer, ("h", "w"))
    y, x = np.indices(s.shape)
    u, v, nearness = see(view, x, y, s.astype(np.float64))
    column, row = np.floor(u + 0.5), np.floor(v + 0.5)
    inside = (column >= 0) & (column < buffer.shape[1]) & (row >= 0) & (row < buffer.shape[0])
    out = np.zeros(s.shape, np.uint8)
    nearest = buffer[row[inside].astype(int), column[inside].astype(int)]
    out[inside] = nearest <= nearness[inside] + tolerance
    return out
