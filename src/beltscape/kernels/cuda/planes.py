"""Plans of launches of expressions, windows over planes and their statistics: the headers of these names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.cuda.device import blocks_of
from beltscape.kernels.cuda.least_squares import TILE, tile_grid
from beltscape.kernels.cuda.memory import DeviceArray
from beltscape.kernels.cuda.workspace import Workspace

_THREADS = 256, 1, 1
"""Of a block, which take an element of a row each."""
_BLOCK_THREADS = 256, 1, 1
"""Of the one block that goes through a whole plane (``kRankThreads``, ``kMeanThreads``)."""
MOST_DISTANCE_PX = 128
"""Distance from a mask at which the search ends: a proximity of exp(-128 / 7.2) is below single precision."""
_MOST_ROWS = 65535
"""Blocks of a grid along y; a thread takes several rows where there are more."""


def evaluate_expression(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute a program of `beltscape.kernels.expressions` for a result of two axes."""
    height, width = out[0].shape
    result = work.allocate(out[0].shape, out[0].dtype)
    program, inputs = upload_programs(work, given)
    kernel = "evaluate_floats" if out[0].dtype == np.float32 else "evaluate_bytes"
    grid = blocks_of(width, _THREADS[0]), min(height, _MOST_ROWS), 1
    as_bytes = result if out[0].dtype == np.float32 else result.viewed(np.dtype(np.uint8))
    work.launch(kernel, grid, _THREADS, program, len(given.program), *inputs, width, height, as_bytes)
    return [result]


def upload_programs(work: Workspace, given: Any) -> tuple[DeviceArray, tuple[DeviceArray, ...]]:
    """Return the operations of programs, and their inputs' addresses, layouts and constants."""
    layout = np.array([_layout_of(each) for each in given.inputs] or [(0, 0, 0)], np.int32)
    inputs = work.upload_all(given.inputs), work.upload(layout), work.upload(given.constants)
    return work.upload(given.program), inputs


def _layout_of(array: Any) -> tuple[int, int, int]:
    """Return whether it has bytes, and the steps to its next row and column."""
    rows, columns = array.shape
    is_byte = int(array.dtype != np.float32)
    return is_byte, columns if rows > 1 else 0, 1 if columns > 1 else 0


def average_windows(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.planes.PlaneKernels.average_windows`."""
    height, width = out[0].shape
    columns, rows = given.size
    sums, result = work.allocate((2, height, width), np.float32), work.allocate((height, width), np.float32)
    repeated = int(given.choice)
    plane = work.upload(given.plane), width, height
    grid = tile_grid((height, width))
    work.launch("sum_window_rows", grid, TILE, *plane, columns // 2, repeated, sums)
    averaged = sums, width, height, rows // 2, repeated, columns
    work.launch("average_window_columns", grid, TILE, *averaged, result)
    return [result]


def measure_moments(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.planes.PlaneKernels.measure_moments`."""
    height, width = out[0].shape
    columns, rows = given.size
    sums = work.allocate((4, height, width), np.float32)
    results = [work.allocate((height, width), np.float32) for _ in out]
    repeated, grid = int(given.choice), tile_grid((height, width))
    plane = work.upload(given.plane), width, height
    work.launch("sum_moment_rows", grid, TILE, *plane, columns // 2, repeated, sums)
    averaged = sums, width, height, rows // 2, repeated, columns
    work.launch("average_moment_columns", grid, TILE, *averaged, *results)
    return results


def find_extremes(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.planes.PlaneKernels.find_extremes`."""
    height, width = out[0].shape
    columns, rows = given.size
    of_rows, result = (work.allocate((height, width), np.float32) for _ in range(2))
    size, largest = (width, height), int(given.choice)
    grid = tile_grid((height, width))
    work.launch(
        "window_row_extremes", grid, TILE, work.upload(given.plane), *size, columns // 2, largest, of_rows
    )
    work.launch("window_column_extremes", grid, TILE, of_rows, *size, rows // 2, largest, result)
    return [result]


def median_of_windows(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.planes.PlaneKernels.median_of_windows`."""
    height, width = out[0].shape
    result = work.allocate((height, width), np.float32)
    plane = work.upload(given.plane)
    work.launch("median_of_window", tile_grid((height, width)), TILE, plane, width, height, result)
    return [result]


def measure_distances(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.planes.PlaneKernels.measure_distances`."""
    height, width = out[0].shape
    along, result = work.allocate((height, width), np.int32), work.allocate((height, width), np.float32)
    grid, size = tile_grid((height, width)), (width, height, MOST_DISTANCE_PX)
    work.launch("distance_along_row", grid, TILE, work.upload(given.mask), *size, along)
    work.launch("distance_to_mask", grid, TILE, along, *size, result)
    return [result]


def average_areas(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.planes.PlaneKernels.average_areas`."""
    return _resize(work, "average_areas", given, out)


def interpolate_plane(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.planes.PlaneKernels.interpolate_plane`."""
    return _resize(work, "interpolate_plane", given, out)


def average_blocks(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.planes.PlaneKernels.average_blocks`."""
    return _launch_blocks(work, "average_blocks", given, out, given.plane.shape[1], given.step)


def repeat_blocks(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.planes.PlaneKernels.repeat_blocks`."""
    return _launch_blocks(work, "repeat_blocks", given, out, *given.plane.shape[::-1], given.step)


def subsample_plane(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.planes.PlaneKernels.subsample_plane`."""
    layout = given.plane.shape[1], given.first, given.step
    return _launch_blocks(work, "subsample_plane", given, out, *layout)


def filter_plane(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.statistics.StatisticsKernels.filter_plane`."""
    height, width = out[0].shape
    result = work.allocate((height, width), np.float32)
    rows, columns = given.weights.shape
    plane, weights = work.upload(given.plane), work.upload(given.weights)
    window = weights, columns, rows, int(given.is_repeated)
    work.launch("filter_plane", tile_grid((height, width)), TILE, plane, width, height, *window, result)
    return [result]


def find_quantile(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.statistics.StatisticsKernels.find_quantile`."""
    result = work.allocate(out[0].shape, np.float32)
    sizes = np.array([each.size for each in given.arrays], np.int32)
    arrays = work.upload_all(given.arrays), work.upload(sizes), len(sizes)
    millionths = round(1e6 * given.share)
    work.launch("find_quantile", (1, 1, 1), _BLOCK_THREADS, *arrays, millionths, result)
    return [result]


def average_plane(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.statistics.StatisticsKernels.average_plane`."""
    result = work.allocate(out[0].shape, np.float32)
    plane = work.upload(given.plane), given.plane.size
    work.launch("mean_level", (1, 1, 1), _BLOCK_THREADS, *plane, result)
    return [result]


def _launch_blocks(
    work: Workspace, kernel: str, given: Any, out: Sequence[NDArray[Any]], *layout: int
) -> list[DeviceArray]:
    height, width = out[0].shape
    result = work.allocate((height, width), np.float32)
    plane = work.upload(given.plane)
    work.launch(kernel, tile_grid((height, width)), TILE, plane, *layout, width, height, result)
    return [result]


def _resize(work: Workspace, kernel: str, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    (rows, columns), (height, width) = given.plane.shape, out[0].shape
    result = work.allocate((height, width), np.float32)
    plane = work.upload(given.plane), columns, rows
    work.launch(kernel, tile_grid((height, width)), TILE, *plane, width, height, result)
    return [result]
