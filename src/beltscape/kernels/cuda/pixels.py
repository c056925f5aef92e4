"""Plans of launches of lists of pixels: native/cuda/pixels.cuh."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.cuda.device import blocks_of
from beltscape.kernels.cuda.images import grid_of
from beltscape.kernels.cuda.memory import DeviceArray
from beltscape.kernels.cuda.planes import evaluate_expression
from beltscape.kernels.cuda.workspace import Workspace
from beltscape.kernels.expressions import ExpressionInput

_SEGMENT = 64
"""Pixels that a thread counts (``kSegment`` of pixels.cuh)."""
_THREADS = 128, 1, 1
"""Of a block, which take a pixel or a segment each."""
_SCAN_THREADS = 256, 1, 1
"""Of the block that adds the counts up (``kScanThreads``)."""


def list_pixels(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.planes.PixelKernels.list_pixels`."""
    size, width = given.mask.size, given.mask.shape[1]
    segments = blocks_of(size, _SEGMENT)
    mask, counts = work.upload(given.mask), work.allocate((segments,), np.int32)
    rows, columns, total = (work.allocate(array.shape, array.dtype) for array in out)
    work.launch("count_pixels", grid_of(segments), _THREADS, mask, size, counts)
    work.launch("sum_counts", (1, 1, 1), _SCAN_THREADS, counts, segments, total)
    work.launch("list_pixels", grid_of(segments), _THREADS, mask, size, width, counts, rows, columns)
    beyond = grid_of(size // 8 + 9)
    work.launch("repeat_first_pixel", beyond, _THREADS, total, size, rows, columns)
    return [rows, columns, total]


def put_pixels(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.planes.PixelKernels.put_pixels`."""
    if isinstance(given.plane, ExpressionInput):
        (plane,) = evaluate_expression(work, given.plane, out)
    else:
        plane = work.allocate(out[0].shape, np.float32)
        work.launch("copy_floats", grid_of(plane.size), _THREADS, work.upload(given.plane), plane.size, plane)
    places = work.upload(given.rows), work.upload(given.columns), given.rows.size
    values, width = work.upload(given.values), out[0].shape[1]
    if given.rows.size:
        work.launch("put_pixels", grid_of(given.rows.size), _THREADS, *places, values, width, plane)
    return [plane]


def assign_addresses(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.planes.PixelKernels.assign_addresses`."""
    size, pixels = given.accepted.size, given.rows.size
    addresses = work.allocate(out[0].shape, np.int32)
    accepted = work.upload(given.accepted)
    work.launch("begin_addresses", grid_of(size), _THREADS, accepted, size, addresses)
    places = work.upload(given.rows), work.upload(given.columns), pixels, out[0].shape[1]
    if pixels:
        work.launch("number_pixels", grid_of(pixels), _THREADS, *places, given.first, addresses)
    return [addresses]


def pick_best(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.planes.PixelKernels.pick_best`."""
    candidates, pixels = given.scores.shape
    result = work.allocate(out[0].shape, np.float32)
    scores, planes = work.upload(given.scores), work.upload_all(given.planes)
    work.launch(
        "pick_best",
        grid_of(pixels),
        _THREADS,
        scores,
        candidates,
        pixels,
        planes,
        len(given.planes),
        result,
    )
    return [result]
