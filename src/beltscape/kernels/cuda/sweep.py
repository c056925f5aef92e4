"""Plans of launches of the plane sweep and of semi-global aggregation: native/cuda/sweep.cuh, aggregate.cuh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.cuda.device import SHARED_BYTES, blocks_of
from beltscape.kernels.cuda.memory import DeviceArray
from beltscape.kernels.cuda.workspace import Workspace

MOST_BEST = 8
"""Views that are averaged at most (``kMostBest`` of sweep.cuh)."""
_TILE = 32, 8, 1
"""Threads of a block, which take a pixel each (``kTileWidth``, ``kTileHeight``)."""
_MEAN_THREADS = 256, 1, 1
"""Threads of a block that averages views, a pixel each."""
_WARP = 32
"""Threads of a warp."""
_UNIT = 32
"""Pixels of which an aligned image's first one is a multiple, and its rows' length (``kAlignedUnit``)."""
_SMALLEST_SPLINE = 4
"""Pixels of a side that cubic interpolation needs."""
_DIRECTIONS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (-1, 1), (1, -1))
"""Directions (columns, rows) of the paths of aggregation."""


def can_sweep(given: Any) -> bool:
    """Return whether the input is within the limits of the kernels."""
    return given.best <= MOST_BEST


def sweep(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.sweep.PlaneSweepKernels.sweep`."""
    return [_sweep_rows(work, given, given.first_row, len(out[0]))]


def aggregate(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.sweep.PlaneSweepKernels.aggregate`: one band without a halo."""
    del out
    rows = len(given.cost)
    return _aggregate_bands(work, work.upload(given.cost), given, _RowBands(rows, rows, 0))


def sweep_and_aggregate(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.sweep.PlaneSweepKernels.sweep_and_aggregate`; 3 bytes of memory for each cost."""
    del out
    rows = len(given.core)
    costs = _sweep_rows(work, given, 0, rows)
    return _aggregate_bands(work, costs, given, _RowBands(rows, given.band_rows, given.halo_rows))


@dataclass(frozen=True, slots=True)
class _RowBands:
    """Rows cut into bands, each aggregated by itself with a halo on either side."""

    rows: int
    band_rows: int
    halo_rows: int

    @property
    def count(self) -> int:
        return blocks_of(self.rows, self.band_rows)

    @property
    def most_rows(self) -> int:
        """Rows of a band with its halo."""
        return min(self.rows, self.band_rows + 2 * self.halo_rows)


@dataclass(frozen=True, slots=True)
class _AlignedImages:
    """The auxiliaries' images in the directions of the core's grid, in the device's memory."""

    core: Any
    """(H, W) grey levels of the core."""
    level: Any
    """(1,) the core's mean, which is taken off all grey levels."""
    pixels: Any
    """Grey levels of all aligned images, one after the other."""
    table: Any
    """(n, 6) left, top, width, height, first (in _UNIT pixels), stride of each (``Aligned`` of sweep.cuh)."""
    positions: Any
    """(n, planes, 4) where each plane lies in each aligned image."""


def _sweep_rows(work: Workspace, given: Any, first_row: int, rows: int) -> Any:
    """Return (rows, W, planes) costs on the device."""
    aligned = _align_images(work, given)
    height, width = given.core.shape
    costs = work.allocate((rows, width, given.planes), np.uint8)
    work.launch(
        "sweep_planes",
        (blocks_of(width, _TILE[0]), blocks_of(rows, _TILE[1]), 1),
        _TILE,
        *(aligned.core, width, height, aligned.level),
        *(aligned.pixels, aligned.table, aligned.positions, len(given.images)),
        *(given.planes, work.upload_number(given.floor), given.best, first_row, rows, costs),
    )
    return costs


def _align_images(work: Workspace, given: Any) -> _AlignedImages:
    """Return the images aligned with the core's grid over the field that the planes take of each."""
    core = work.upload(given.core)
    level = work.allocate((1,), np.float32)
    work.launch("mean_level", (1, 1, 1), _MEAN_THREADS, core, given.core.size, level)
    views = work.upload(given.views)
    positions, table = _position_planes(work, given, views)
    on_device = work.upload(table)
    last = table[-1]
    pixels = work.allocate(((last[4] + last[5] // _UNIT * last[3]) * _UNIT,), np.float32)
    for i, image in enumerate(given.images):
        height, stride = int(table[i, 3]), int(table[i, 5])
        if not height:
            continue
        grid = blocks_of(stride, _TILE[0]), blocks_of(height, _TILE[1]), 1
        from_image = work.upload(image), image.shape[1], image.shape[0]
        work.launch("align_image", grid, _TILE, views, i, *from_image, on_device, level, pixels)
    return _AlignedImages(core, level, pixels, on_device, positions)


def _position_planes(work: Workspace, given: Any, views: Any) -> tuple[Any, NDArray[np.int32]]:
    """Return the positions of all planes (on the device) and the table of aligned images."""
    count, planes = len(given.images), (float(given.first), float(given.step), given.planes)
    height, width = given.core.shape
    shifts = work.allocate((count, 3), np.float32)
    fields = work.allocate((count, 4), np.int32)
    grid, block = (blocks_of(count, _WARP), 1, 1), (_WARP, 1, 1)
    work.launch("aligned_fields", grid, block, views, count, *planes, width, height, shifts, fields)
    positions = work.allocate((count, given.planes, 4), np.float32)
    grid = blocks_of(given.planes, _WARP), count, 1
    work.launch("plane_places", grid, block, shifts, count, *planes, positions)

    table = np.zeros((count, 6), np.int32)
    is_constant = isinstance(
        given.views, np.ndarray
    )  # as are the planes: a frame's images change nothing here
    table[:, :4] = (work.read_constant if is_constant else work.download_new)(fields)
    table[[min(image.shape) < _SMALLEST_SPLINE for image in given.images], :4] = 0
    table[:, 5] = (table[:, 2] + 3 + _UNIT - 1) // _UNIT * _UNIT
    units = table[:, 5] // _UNIT * table[:, 3]
    table[1:, 4] = np.cumsum(units)[:-1]
    return positions, table


def _aggregate_bands(work: Workspace, costs: DeviceArray, given: Any, bands: _RowBands) -> list[DeviceArray]:
    """Aggregate (rows, W, planes) costs along eight directions to plane and margin."""
    rows, width, planes = costs.shape
    sums = work.allocate((rows, width, planes), np.uint16)
    path_bytes = 4 * (planes + 2)  # two pixels' planes, as words
    warps = next(count for count in (4, 2, 1) if count * path_bytes <= SHARED_BYTES)
    for number, (dx, dy) in enumerate(_DIRECTIONS):
        paths = bands.band_rows if dy == 0 else width + (bands.most_rows - 1) * abs(dx)
        work.launch(
            "aggregate_direction",
            (blocks_of(paths, warps), bands.count, 1),
            (_WARP, warps, 1),
            *(costs, rows, width, planes, bands.band_rows, bands.halo_rows),
            *(dx, dy, given.small_jump, given.large_jump, int(number == 0), sums),
            shared_bytes=warps * path_bytes,
        )
    index, margin = (work.allocate((rows, width), np.float32) for _ in range(2))
    pixels, warps = rows * width, 8
    grid = blocks_of(pixels, warps), 1, 1
    work.launch("select_planes", grid, (_WARP, warps, 1), costs, sums, pixels, planes, index, margin)
    return [index, margin]
