"""The plane sweep: the first inverse depths, from planes over small images with semi-global aggregation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.frame.frame import PreparedFrame, downsample
from beltscape.stereo.multiview.frame.inverse_depth import pack_projections

_SMALL_JUMP, _LARGE_JUMP = 7, 40
"""Penalties of the aggregation for a jump by one plane and by more."""
_LEAST_PLANES = 4
"""The least that the kernel of the aggregation accepts."""


def shrink_frame(prepared: PreparedFrame, shrink: int) -> PreparedFrame:
    """Return the frame with all images ``shrink`` times smaller, for a sweep.

    Inverse depth s still counts pixels of the large grid; the spline coefficients remain those of the large images.
    """
    context = prepared.context
    return replace(
        prepared,
        core=downsample(prepared.filled_core, shrink),
        images=tuple(downsample(image, shrink) for image in prepared.images),
        views=pack_projections(
            context.rig, context.auxiliaries, context.inverse_depth_scale, context.step * shrink
        ),
    )


def sweep_planes(
    prepared: PreparedFrame, s_range: tuple[float, float], plane_step: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return (H, W) inverse depth s of the plane of least cost, and (H, W) its margin over the second best.

    Planes lie ``plane_step`` apart within ``s_range`` = (far, near), from the farthest on. The cost is that of the
    two auxiliaries that match the core best on windows of 3 × 3 pixels; two, because opposite auxiliaries are
    rarely occluded together.
    """
    far, near = s_range
    context = prepared.context
    planes = max(_LEAST_PLANES, int(np.ceil((near - far) / plane_step)) + 1)
    index, margin = context.kernels.sweep_and_aggregate(
        prepared.core, prepared.images, prepared.views, far, plane_step, planes, prepared.noise.floor,
        _SMALL_JUMP, _LARGE_JUMP, best=2, threads=context.threads,
    )  # fmt: skip
    return (far + plane_step * index).astype(np.float32), margin
