"""The first inverse depths of a frame: a plane sweep over small images, of a range that coarse matching narrows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.frame.surface import enlarge_blocks
from beltscape.stereo.multiview.initialisation.plane_sweep import shrink_frame, sweep_planes
from beltscape.stereo.multiview.initialisation.reliable_matches import (
    compute_robust_range,
    find_reliable_matches,
)

_MANY_PLANES = 96
"""Number of planes above which coarse matching narrows the range first; that costs an eighth of a sweep."""


@dataclass(frozen=True, slots=True)
class SweepResolution:
    """Resolution of a plane sweep."""

    shrink: int
    """Factor by which the sweep's images are smaller than the matcher's grid."""
    plane_step_px: float
    """Distance of the planes in pixels of the sweep's images."""

    @property
    def plane_step(self) -> float:
        """Distance of the planes in s."""
        return self.plane_step_px * self.shrink


def initialise_inverse_depth(
    prepared: PreparedFrame, s_range: tuple[float, float], resolution: SweepResolution
) -> NDArray[np.float32]:
    """Return (H, W) inverse depth s of a plane sweep within ``s_range`` = (far, near)."""
    if s_range[1] - s_range[0] > _MANY_PLANES * resolution.plane_step:
        s_range = _narrow_range(prepared, s_range, resolution)
    swept, _ = sweep_planes(shrink_frame(prepared, resolution.shrink), s_range, resolution.plane_step)
    return enlarge_blocks(swept, resolution.shrink, prepared.core.shape)


def _narrow_range(
    prepared: PreparedFrame, s_range: tuple[float, float], resolution: SweepResolution
) -> tuple[float, float]:
    """Return the (far, near) part of ``s_range`` that holds the reliable matches at half the sweep's resolution.

    The result is all of ``s_range`` when there are too few of them.
    """
    context, half = prepared.context, shrink_frame(prepared, 2 * resolution.shrink)
    splines = tuple(
        context.kernels.spline_coefficients(image, threads=context.threads) for image in half.images
    )
    matches = find_reliable_matches(replace(half, coefficients=splines), s_range, 2 * resolution.plane_step)
    far, near = compute_robust_range(matches) or s_range
    return max(far, s_range[0]), min(near, s_range[1])
