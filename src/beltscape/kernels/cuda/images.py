"""Plans of launches of splines, gathering, buffers of inverse depth and visibility: images.cuh, visibility.cuh."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.cuda.device import blocks_of
from beltscape.kernels.cuda.least_squares import TILE, tile_grid
from beltscape.kernels.cuda.memory import DeviceArray
from beltscape.kernels.cuda.workspace import Workspace

_THREADS = 128, 1, 1
"""Of a block, which take a line or a pixel each."""
_GAIN = 6.0
"""Of the filter along one axis (``kGain`` of prefilter.hpp)."""
_MOST_ROWS = 65535
"""Blocks of a grid along y."""


def can_gather(given: Any) -> bool:
    """Return whether the input is within the limits of a grid."""
    return len(given.planes) * len(given.offsets) <= _MOST_ROWS


def spline_coefficients(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.images.WarpingKernels.spline_coefficients`."""
    height, width = given.image.shape
    gain = (_GAIN if width > 1 else 1.0) * (_GAIN if height > 1 else 1.0)
    coefficients = work.allocate(out[0].shape, out[0].dtype)
    image = work.upload(given.image)
    work.launch("filter_rows", grid_of(height), _THREADS, image, width, height, gain, coefficients)
    work.launch("filter_columns", grid_of(width), _THREADS, coefficients, width, height)
    return [coefficients]


def gather(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.images.GatheringKernels.gather`."""
    height, width = given.planes[0].shape
    values = work.allocate(out[0].shape, out[0].dtype)
    rows, pixels = out[0].shape
    if not rows:
        return [values]
    grid = blocks_of(pixels, _THREADS[0]), rows, 1
    planes = work.upload_all(given.planes), width, height
    places = work.upload(given.u), work.upload(given.v), pixels
    offsets = work.upload(given.offsets), len(given.offsets)
    work.launch("gather_values", grid, _THREADS, *planes, *places, *offsets, values)
    return [values]


def grid_of(count: int) -> tuple[int, int, int]:
    """Return the blocks for a thread each of ``count``."""
    return blocks_of(count, _THREADS[0]), 1, 1


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
