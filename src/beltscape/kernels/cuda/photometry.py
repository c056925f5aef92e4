"""Plans of launches of the kernels of a frame's images: photometry.cuh."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.cuda.images import grid_of
from beltscape.kernels.cuda.least_squares import TILE, tile_grid
from beltscape.kernels.cuda.memory import DeviceArray
from beltscape.kernels.cuda.workspace import Workspace

_STRETCH, _SUMS = 128, 8
"""Pixels that are added up without halving, and sums that they share (``kStretch`` and ``kSums``)."""
_THREADS = 128, 1, 1
"""Of a block, which take a stretch each."""
_JOIN_THREADS = 256, 1, 1
"""Of the one block that joins sums (``kJoinThreads``)."""
_ROW_THREADS, _PHASE_THREADS = (16, 1, 1), (64, 1, 1)
"""Of a row's block (``kRowParts``, ``kPhaseThreads``)."""
_MOMENTS, _PHASES, _BLURS = 4, 4, 3
"""Numbers of a row (``kMoments``, ``kPhases``) and of blurs."""
_FEW_THREADS = 4, 1, 1
"""Of the block that joins the rows' numbers, a thread each."""


def measure_contrast(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.photometry.PhotometryKernels.measure_contrast`."""
    size = given.image.size
    depth = count_halvings(size)
    kernel = f"sum_stretches_of_{_name_of(given)}"
    image, sums = work.upload(given.image), work.allocate((1 << depth,), np.float32)
    mean, found = (work.allocate(out[0].shape, np.float32) for _ in range(2))
    for are_squares, result in ((0, mean), (1, found)):
        work.launch(kernel, grid_of(1 << depth), _THREADS, image, size, depth, are_squares, mean, sums)
        work.launch("join_stretches", (1, 1, 1), _JOIN_THREADS, sums, depth, size, are_squares, result)
    return [found]


def count_halvings(size: int) -> int:
    """Return how often a line is halved at most until its parts are short."""
    depth = 0
    while size > _STRETCH:
        half = size // 2
        size -= half - half % _SUMS
        depth += 1
    return depth


def make_levels(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.photometry.PhotometryKernels.make_levels`."""
    height, width = out[0].shape
    result = work.allocate(out[0].shape, np.float32)
    gain = given.gain if hasattr(given.gain, "dtype") else np.array(given.gain, np.float32)
    image = work.upload(given.image), width, height
    kernel = f"levels_of_{_name_of(given)}"
    work.launch(kernel, tile_grid((height, width)), TILE, *image, work.upload(gain), result)
    return [result]


def _name_of(given: Any) -> str:
    """Return what a kernel of an image of this type is named by."""
    return "words" if given.bytes is None else "bytes"


def measure_sharpness(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.photometry.PhotometryKernels.measure_sharpness`."""
    height, width = given.image.shape
    grid, size = tile_grid((height, width)), (width, height)
    weights = work.upload(given.weights), work.upload(given.radii)
    blurred = work.allocate((_BLURS, height, width), np.float32)
    differences = work.allocate((2, height, width), np.float32)
    moments, found = work.allocate((height, _MOMENTS), np.float32), work.allocate(out[0].shape, np.float32)
    work.launch("blur_columns", grid, TILE, work.upload(given.image), *size, *weights, blurred)
    work.launch("blur_rows", grid, TILE, blurred, *size, *weights, differences)
    work.launch("sum_row_moments", (height, 1, 1), _ROW_THREADS, differences, *size, moments)
    work.launch("join_row_moments", (1, 1, 1), _FEW_THREADS, moments, *size, found)
    return [found]


def measure_phases(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.photometry.PhotometryKernels.measure_phases`."""
    height, width = given.image.shape
    sums, found = work.allocate((height, _PHASES), np.float32), work.allocate(out[0].shape, np.float32)
    work.launch("sum_phases", (height, 1, 1), _PHASE_THREADS, work.upload(given.image), width, height, sums)
    work.launch("join_phases", (1, 1, 1), _FEW_THREADS, sums, width, height, found)
    return [found]
