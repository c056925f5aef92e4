"""The first surface: a sweep of planes over small images, all auxiliaries at once, aggregated semi-globally."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from beltscape.core.rig import Rig
from beltscape.kernels import Kernels
from beltscape.stereo.prepared import PreparedFrame, cut_view, reduced, view_rows

_SMALL_JUMP, _LARGE_JUMP = 7, 40
_LEAST_PLANES = 4


def coarse_surface(
    rig: Rig,
    auxiliaries: tuple[str, ...],
    prepared: PreparedFrame,
    nearness: tuple[float, float],
    *,
    block: tuple[slice, slice] | None = None,
    step: int,
    shrink: int,
    plane_step_px: float,
    unit: float,
    kernels: Kernels,
    threads: int,
) -> NDArray[np.float32]:
    """(h, w) nearness s of the first surface between ``nearness`` = (far, near), in a block of the prepared grid.

    ``block`` is rows and columns, beginning at multiples of ``shrink``; the whole grid by default. ``step`` is
    the grid's block size in image pixels, ``shrink`` how much smaller the sweep's images are, ``plane_step_px``
    the planes' distance in those. The cost is kernels.coarse's: the two auxiliaries that agree best with the core
    on windows of 3 × 3 pixels; two because opposite auxiliaries are rarely occluded together.
    """
    plane = plane_step_px * shrink
    rows, columns = block or (slice(0, prepared.core.shape[0]), slice(0, prepared.core.shape[1]))
    core = prepared.core[rows, columns]
    small = replace(
        prepared,
        core=reduced(core, shrink),
        images=tuple(reduced(image, shrink) for image in prepared.images),
    )
    corner = columns.start // shrink, rows.start // shrink
    views = np.stack([cut_view(row, *corner) for row in view_rows(rig, auxiliaries, unit, step * shrink)])
    index, _ = sweep(small, views, nearness, plane, kernels, threads)
    return _enlarged(nearness[0] + plane * index, shrink, core.shape)


def sweep(
    prepared: PreparedFrame,
    views: NDArray[np.float32],
    nearness: tuple[float, float],
    plane: float,
    kernels: Kernels,
    threads: int,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(H, W) plane and margin by which it won: kernels.coarse with the matcher's own floor and jumps.

    Planes lie ``plane`` apart between ``nearness`` = (far, near), from the farthest on.
    """
    far, near = nearness
    planes = max(_LEAST_PLANES, int(np.ceil((near - far) / plane)) + 1)
    return kernels.coarse(
        prepared.core, prepared.images, views, far, plane, planes, prepared.noise.floor,
        _SMALL_JUMP, _LARGE_JUMP, best=2, threads=threads,
    )  # fmt: skip


def _enlarged(small: NDArray[np.floating], step: int, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Every value over its block: steps of depth stay steps."""
    full = np.repeat(np.repeat(small.astype(np.float32), step, axis=0), step, axis=1)
    missing = [(0, whole - have) for whole, have in zip(shape, full.shape, strict=True)]
    return np.ascontiguousarray(np.pad(full, missing, mode="edge"))
