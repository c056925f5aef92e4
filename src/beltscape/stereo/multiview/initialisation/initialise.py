"""The first inverse depths of a frame: predicted from the previous frame where that fits, swept elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.frame.planes import enlarge_blocks
from beltscape.stereo.multiview.initialisation.plane_sweep import (
    Block,
    crop_frame,
    shrink_frame,
    sweep_planes,
)
from beltscape.stereo.multiview.initialisation.reliable_matches import (
    compute_robust_range,
    find_reliable_matches,
)
from beltscape.stereo.multiview.initialisation.unmeasured_regions import find_unmeasured_blocks

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
    predicted: NDArray[np.float32] | None,
    prepared: PreparedFrame,
    s_range: tuple[float, float],
    resolution: SweepResolution,
) -> NDArray[np.float32]:
    """Return (H, W) inverse depth s within ``s_range`` = (far, near): ``predicted`` where finite, swept elsewhere.

    ``predicted`` (H, W) is the result of `temporal_prior.predict_inverse_depth`; without it the whole grid is swept.
    """
    s = np.full(prepared.core.shape, np.nan, np.float32) if predicted is None else predicted.copy()
    strips, holes = find_unmeasured_blocks(s, 2 * resolution.shrink)
    blocks = strips + holes
    if not blocks:
        return s
    small = shrink_frame(prepared, resolution.shrink)
    ranges = [s_range] * len(blocks)
    if s_range[1] - s_range[0] > _MANY_PLANES * resolution.plane_step:
        matches = _match_coarsely(strips, prepared, s_range, resolution)
        ranges = _compute_block_ranges(
            s, blocks, [*matches, *[np.empty(0, np.float32)] * len(holes)], s_range
        )
    for block, block_range in zip(blocks, ranges, strict=True):
        swept, _ = sweep_planes(
            crop_frame(small, _scale_block(block, resolution.shrink)), block_range, resolution.plane_step
        )
        here = s[block]
        s[block] = np.where(np.isfinite(here), here, enlarge_blocks(swept, resolution.shrink, here.shape))
    return s


def _match_coarsely(
    strips: list[Block],
    prepared: PreparedFrame,
    s_range: tuple[float, float],
    resolution: SweepResolution,
) -> list[NDArray[np.float32]]:
    """Return (N,) inverse depth of the reliable matches in each strip, at half the sweep's resolution."""
    shrink = 2 * resolution.shrink
    half, context = shrink_frame(prepared, shrink), prepared.context
    splines = tuple(
        context.kernels.spline_coefficients(image, threads=context.threads) for image in half.images
    )
    half = replace(half, coefficients=splines)
    return [
        find_reliable_matches(
            crop_frame(half, _scale_block(strip, shrink)), s_range, 2 * resolution.plane_step
        )
        for strip in strips
    ]


def _compute_block_ranges(
    s: NDArray[np.float32],
    blocks: list[Block],
    matches: Sequence[NDArray[np.float32]],
    s_range: tuple[float, float],
) -> list[tuple[float, float]]:
    """Return the (far, near) range of s for each block, from the finite s in it and its reliable matches.

    A block without either takes the range of all finite s; without any finite s it takes all of ``s_range``.
    """
    overall = compute_robust_range(s[np.isfinite(s)]) or s_range
    ranges: list[tuple[float, float]] = []
    for block, matched in zip(blocks, matches, strict=True):
        here = s[block]
        candidates = compute_robust_range(here[np.isfinite(here)]), compute_robust_range(matched)
        parts = [part for part in candidates if part]
        far, near = zip(*(parts or [overall]), strict=True)
        ranges.append((max(min(far), s_range[0]), min(max(near), s_range[1])))
    return ranges


def _scale_block(block: Block, shrink: int) -> Block:
    rows, columns = (slice(part.start // shrink, -(-part.stop // shrink)) for part in block)
    return rows, columns
