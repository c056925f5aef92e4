"""The first surface: a sweep of planes over small images, all auxiliaries at once, aggregated semi-globally."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from beltscape.core.rig import Rig
from beltscape.kernels import Kernels
from beltscape.stereo.multiview.frame.frame import (
    PreparedFrame,
    crop_projection,
    downsample,
    packed_projections,
)

_SMALL_JUMP, _LARGE_JUMP = 7, 40
_LEAST_PLANES = 4

Block = tuple[slice, slice]
"""Rows and columns of a grid."""


def shrink_frame(
    rig: Rig, auxiliaries: tuple[str, ...], prepared: PreparedFrame, *, step: int, shrink: int, unit: float
) -> PreparedFrame:
    """All images ``shrink`` times smaller; the splines are still those of the large ones.

    ``step`` is the prepared grid's block size in image pixels; nearness s still counts that grid's pixels.
    """
    return replace(
        prepared,
        core=downsample(prepared.core, shrink),
        images=tuple(downsample(image, shrink) for image in prepared.images),
        views=packed_projections(rig, auxiliaries, unit, step * shrink),
    )


def crop_frame(prepared: PreparedFrame, block: Block) -> PreparedFrame:
    """The same with a block of the core's grid only."""
    rows, columns = block
    views = np.stack([crop_projection(row, columns.start, rows.start) for row in prepared.views])
    return replace(prepared, core=np.ascontiguousarray(prepared.core[block]), views=views)


def sweep_planes(
    prepared: PreparedFrame, nearness: tuple[float, float], plane: float, kernels: Kernels, threads: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(H, W) nearness s of the first surface, and the margin by which its plane won.

    Planes lie ``plane`` apart between ``nearness`` = (far, near), from the farthest on. The cost is
    kernels.coarse's: the two auxiliaries that agree best with the core on windows of 3 × 3 pixels; two because
    opposite auxiliaries are rarely occluded together.
    """
    far, near = nearness
    planes = max(_LEAST_PLANES, int(np.ceil((near - far) / plane)) + 1)
    index, margin = kernels.sweep_and_aggregate(
        prepared.core, prepared.images, prepared.views, far, plane, planes, prepared.noise.floor,
        _SMALL_JUMP, _LARGE_JUMP, best=2, threads=threads,
    )  # fmt: skip
    return (far + plane * index).astype(np.float32), margin


def enlarge_blocks(small: NDArray[np.floating], shrink: int, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """(H, W) every value over its block: steps of depth stay steps; a rest at the far ends is the last's."""
    full = np.repeat(np.repeat(small.astype(np.float32), shrink, axis=0), shrink, axis=1)
    missing = [(0, whole - have) for whole, have in zip(shape, full.shape, strict=True)]
    return np.ascontiguousarray(np.pad(full, missing, mode="edge"))
