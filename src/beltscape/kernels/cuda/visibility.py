"""Plans of launches of buffers of inverse depth and of visibility: native/cuda/visibility.cuh."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.cuda.images import grid_of
from beltscape.kernels.cuda.least_squares import TILE, tile_grid
from beltscape.kernels.cuda.memory import DeviceArray
from beltscape.kernels.cuda.workspace import Workspace

_THREADS = 128, 1, 1
"""Of a block that fills an array."""


def inverse_depth_buffers(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.geometry.VisibilityKernels.inverse_depth_buffers`."""
    height, width = given.s.shape
    views, s = work.upload(given.views), work.upload(given.s)
    buffers: list[DeviceArray] = []
    for i, array in enumerate(out):
        rows, columns = array.shape
        corners = work.allocate((rows + 1, columns + 1), np.float32)
        work.launch("fill_floats", grid_of(corners.size), _THREADS, corners, corners.size, 0.0)
        seen = views, i, s, width, height, columns, rows
        work.launch("splat_corners", tile_grid(given.s.shape), TILE, *seen, corners)
        buffer = work.allocate(array.shape, array.dtype)
        work.launch("spread_corners", tile_grid(array.shape), TILE, corners, columns, rows, buffer)
        buffers.append(buffer)
    return buffers


def visible(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.geometry.VisibilityKernels.visible`."""
    height, width = given.s.shape
    rows, columns = given.buffer.shape
    mask = work.allocate(out[0].shape, out[0].dtype)
    surface = work.upload(given.view), work.upload(given.s), width, height
    buffer = work.upload(given.buffer), columns, rows, float(given.tolerance)
    work.launch("visible_pixels", tile_grid(given.s.shape), TILE, *surface, *buffer, mask)
    return [mask]
