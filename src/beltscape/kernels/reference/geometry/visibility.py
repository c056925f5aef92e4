"""Visibility of the core's surface from an auxiliary: the reference of `inverse_depth_buffers` and `visible`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.geometry.visibility import BuffersInput, VisibleInput
from beltscape.kernels.reference.view import project


def inverse_depth_buffers(given: BuffersInput, sizes: Sequence[tuple[int, int]]) -> list[NDArray[np.float64]]:
    """Return n buffers of the (width, height) of ``sizes``."""
    return [_buffer(given.s, view, size) for view, size in zip(given.views, sizes, strict=True)]


def _buffer(
    s: NDArray[np.floating], view: NDArray[np.floating], size: tuple[int, int]
) -> NDArray[np.float64]:
    width, height = size
    y, x = cast("NDArray[np.int64]", np.indices(s.shape))
    u, v, inverse_depth = project(view, x, y, s.astype(np.float64))
    u, v, inverse_depth = (a[np.isfinite(u)] for a in (u, v, inverse_depth))
    framed = np.zeros((height + 2, width + 2))  # a pixel all around, for what is seen half outside
    near = (u >= -1) & (u < width) & (v >= -1) & (v < height)
    column, row = np.floor(u[near]).astype(int) + 1, np.floor(v[near]).astype(int) + 1
    for right in (0, 1):
        for down in (0, 1):
            np.maximum.at(framed, (row + down, column + right), inverse_depth[near])
    return framed[1:-1, 1:-1].copy()


def visible(given: VisibleInput) -> tuple[NDArray[np.uint8]]:
    """Return (H, W) 1 where a pixel is seen."""
    s, view, buffer, tolerance = given
    y, x = cast("NDArray[np.int64]", np.indices(s.shape))
    u, v, inverse_depth = project(view, x, y, s.astype(np.float64))
    column, row = np.floor(u + 0.5), np.floor(v + 0.5)
    inside = (column >= 0) & (column < buffer.shape[1]) & (row >= 0) & (row < buffer.shape[0])
    out = np.zeros(s.shape, np.uint8)
    nearest = buffer[row[inside].astype(int), column[inside].astype(int)]
    out[inside] = nearest <= inverse_depth[inside] + tolerance
    return (out,)
