"""Reference of the residuals: what a sound rig leaves in each block of the image, as by its lens models."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from beltscape.core.geometry.rig import Rig
from beltscape.stereo.consistency.residuals import compute_disparity_residuals, compute_pair_residuals
from beltscape.stereo.consistency.systematic_residual import BLOCKS, LEAST_IN_BLOCK, find_blocks
from beltscape.stereo.consistency.tie_points.tie_points import Array, TiePoints


@dataclass(frozen=True, slots=True, eq=False)
class ResidualReference:
    """Block medians of the residuals of a sound rig, px; 0 for a block or camera that was not measured."""

    size_px: tuple[int, int]
    """Size of the core's image."""
    epipolar_px: Mapping[str, Array]
    """By auxiliary: (blocks,) of its epipolar residuals."""
    disparity_px: Mapping[tuple[str, str], Array]
    """By two auxiliaries: (blocks,) of their disparity residuals."""

    def subtract_epipolar(self, residual_px: Array, pixels: Array, name: str) -> Array:
        """Return the epipolar residuals (N,) at the core's pixels (N, 2) without the reference."""
        return self._subtract(residual_px, pixels, self.epipolar_px.get(name))

    def subtract_disparity(self, residual_px: Array, pixels: Array, pair: tuple[str, str]) -> Array:
        """Return the disparity residuals (N,) at the core's pixels (N, 2) without the reference."""
        return self._subtract(residual_px, pixels, self.disparity_px.get(pair))

    def _subtract(self, residual_px: Array, pixels: Array, medians: Array | None) -> Array:
        return residual_px if medians is None else residual_px - medians[find_blocks(pixels, self.size_px)]


def compute_reference(tie_points: TiePoints, rig: Rig, names: tuple[str, ...]) -> ResidualReference:
    """Return the reference from the tie points of sound frames."""
    size_px, pixels = rig.core_camera.size_px, tie_points.core_px
    pairs = {name: compute_pair_residuals(tie_points, rig, name) for name in names}
    return ResidualReference(
        size_px,
        {name: _compute_medians(pairs[name].epipolar_px, pixels, size_px) for name in names},
        {
            (one, other): _compute_medians(
                compute_disparity_residuals(pairs[one], pairs[other]), pixels, size_px
            )
            for one, other in combinations(names, 2)
        },
    )


def _compute_medians(residual_px: Array, pixels: Array, size_px: tuple[int, int]) -> Array:
    """Return (blocks,) medians of the finite residuals."""
    good = np.isfinite(residual_px)
    blocks, values = find_blocks(pixels[good], size_px), residual_px[good]
    out = np.zeros(BLOCKS[0] * BLOCKS[1])
    for block in np.unique(blocks):
        own = values[blocks == block]
        if len(own) >= LEAST_IN_BLOCK:
            out[block] = np.median(own)
    return out
