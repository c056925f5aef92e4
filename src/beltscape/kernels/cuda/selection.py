"""Plans of launches of candidates, photo-consistency and propagation: native/cuda/selection.cuh, propagate.cuh."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.cuda.device import blocks_of
from beltscape.kernels.cuda.images import grid_of
from beltscape.kernels.cuda.least_squares import TILE, tile_grid
from beltscape.kernels.cuda.memory import DeviceArray
from beltscape.kernels.cuda.workspace import Workspace

MOST_VIEWS = 8
"""Views that are compared at most (``kMostSelectionViews`` of selection.cuh)."""
_THREADS = 128, 1, 1
"""Of a block, which take a pixel or a path each."""
_MEAN_THREADS = 256, 1, 1
"""Of the block that averages the core's levels (``kMeanThreads`` of sweep.cuh)."""
_BAND_ROWS, _HALO_ROWS = 128, 12
"""Rows that are chosen at once, and of the halo in which paths begin (``kBandRows``, ``kHaloRows``)."""
_DIRECTIONS = ((0, 1), (1, 1), (-1, 1), (1, 0), (-1, 0), (0, -1), (-1, -1), (1, -1))
"""Directions (columns, rows) of the paths, in the order in which the CPU adds their costs."""
_MOST_ROWS = 65535
"""Blocks of a grid along y."""


def can_select(given: Any) -> bool:
    """Return whether the input is within the limits of the kernels."""
    rows = len(given.planes[0]) if hasattr(given, "planes") else 1
    return len(given.images) <= MOST_VIEWS and rows <= _MOST_ROWS


def candidate_surfaces(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.selection.CandidateKernels.candidate_surfaces`."""
    height, width = given.reliable.shape
    pixels = len(given.u)
    results = work.allocate((len(out), *out[0].shape), np.float32)
    surface = *map(work.upload, given.surface), work.upload(given.reliable), width, height
    places = work.upload(given.u), work.upload(given.v), pixels
    search = given.reach, float(given.separation)
    work.launch("surface_candidates", grid_of(pixels), _THREADS, *surface, *places, *search, results)
    return [results.part(i) for i in range(len(out))]


def photo_consistency(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.selection.CandidateKernels.photo_consistency`."""
    height, width = given.core.shape
    pixels, rows = len(given.u), len(given.planes[0])
    results = work.allocate(out[0].shape, np.float32)
    if not rows:
        return [results]
    grid = blocks_of(pixels, _THREADS[0]), rows, 1
    places = work.upload(given.u), work.upload(given.v), pixels
    planes = *map(work.upload, given.planes), rows
    core = work.upload(given.core), work.upload(given.variance), width, height
    gains = work.upload_all(given.gains), len(given.images), float(given.tolerance)
    auxiliaries = _upload_auxiliaries(work, given)
    work.launch("plane_consistency", grid, _THREADS, *places, *planes, *core, *auxiliaries, *gains, results)
    return [results]


def propagate(work: Workspace, given: Any, out: Sequence[NDArray[Any]]) -> list[DeviceArray]:
    """Compute `beltscape.kernels.selection.PropagationKernels.propagate`; 20 bytes of memory for each candidate."""
    height, width = given.core.shape
    active = work.upload(np.ones((height, width), np.uint8) if given.active is None else given.active)
    places = _find_candidates(work, given, active)
    scores = work.allocate((given.candidates, height, width), np.float32)
    bands = blocks_of(height, _BAND_ROWS)
    jumps = float(given.costs.small_jump), float(given.costs.large_jump)
    for number, (dx, dy) in enumerate(_DIRECTIONS):
        most_rows = min(height, _BAND_ROWS + 2 * _HALO_ROWS)
        paths = _BAND_ROWS if dy == 0 else width + (most_rows - 1) * abs(dx)
        grid = blocks_of(paths, _THREADS[0]), bands, 1
        image = places, active, width, height, given.candidates, _BAND_ROWS, _HALO_ROWS
        work.launch("propagate_direction", grid, _THREADS, *image, dx, dy, *jumps, int(number == 0), scores)
    results = [work.allocate(array.shape, array.dtype) for array in out]
    chosen = places, scores, active, width * height, given.candidates
    work.launch("pick_candidates", grid_of(width * height), _THREADS, *chosen, *results)
    return results


def _find_candidates(work: Workspace, given: Any, active: DeviceArray) -> DeviceArray:
    """Return the (4, candidates, H, W) inverse depth, cost and slopes of all pixels' candidates."""
    height, width = given.core.shape
    core, level = work.upload(given.core), work.allocate((1,), np.float32)
    work.launch("mean_level", (1, 1, 1), _MEAN_THREADS, core, width * height, level)
    offsets = np.concatenate([np.zeros((1, 2), np.int32), given.offsets])
    unseen = float(given.costs.unseen_cost), float(given.costs.tolerance)
    costs = float(given.costs.separation), work.upload_number(given.costs.floor), *unseen
    places = work.allocate((4, given.candidates, height, width), np.float32)
    work.launch(
        "propagate_candidates",
        tile_grid((height, width)),
        TILE,
        *(*map(work.upload, given.surface), core, level, active, width, height),
        *(*_upload_auxiliaries(work, given), len(given.images)),
        *(work.upload(offsets), len(offsets), given.candidates, *costs, places),
    )
    return places


def _upload_auxiliaries(work: Workspace, given: Any) -> tuple[DeviceArray, ...]:
    """Return the projections, the addresses of images and buffers, and the images' (width, height)."""
    sizes = np.array([image.shape[::-1] for image in given.images], np.int32)
    images, buffers = work.upload_all(given.images), work.upload_all(given.buffers)
    return work.upload(given.views), images, buffers, work.upload(sizes)
