"""Where a frame's matching starts: from the frame before where that fits, from a sweep elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltscape.core.rig import Rig
from beltscape.kernels import Kernels
from beltscape.stereo.multiview.frame.frame import PreparedFrame
from beltscape.stereo.multiview.initialisation.plane_sweep import (
    Block,
    crop_frame,
    enlarge_blocks,
    shrink_frame,
    sweep_planes,
)
from beltscape.stereo.multiview.initialisation.reliable_matches import find_reliable_matches, robust_range
from beltscape.stereo.multiview.initialisation.unmeasured_regions import find_unmeasured_blocks

_MANY_PLANES = 96
"""A wider range is narrowed by a coarse look before: that costs an eighth of a sweep."""


@dataclass(frozen=True, slots=True)
class SweepGrid:
    """How sweeps are made."""

    rig: Rig
    auxiliaries: tuple[str, ...]
    step: int
    """The prepared grid's block size in image pixels."""
    shrink: int
    """How much smaller than that grid a sweep's images are."""
    plane_step_px: float
    """Distance of the planes in pixels of those."""
    unit: float
    """1/mm per step of nearness."""

    @property
    def plane(self) -> float:
        """Distance of the planes in steps of nearness."""
        return self.plane_step_px * self.shrink

    def shrink_frame(self, prepared: PreparedFrame, times: int = 1) -> PreparedFrame:
        """What is swept, so many times smaller."""
        return shrink_frame(
            self.rig, self.auxiliaries, prepared, step=self.step, shrink=times * self.shrink, unit=self.unit
        )


def initialise_inverse_depth(
    moved: NDArray[np.float32] | None,
    prepared: PreparedFrame,
    nearness: tuple[float, float],
    sweeps: SweepGrid,
    kernels: Kernels,
    threads: int,
) -> NDArray[np.float32]:
    """(H, W) nearness s between ``nearness`` = (far, near): ``moved`` where it is known, swept where it is missing.

    ``moved`` is `beltscape.stereo.multiview.initialisation.temporal_prior.moved_nearness`; without it the whole grid is swept.
    """
    s = np.full(prepared.core.shape, np.nan, np.float32) if moved is None else moved.copy()
    strips, holes = find_unmeasured_blocks(s, 2 * sweeps.shrink)
    blocks = strips + holes
    if not blocks:
        return s
    small = sweeps.shrink_frame(prepared)
    spans = [nearness] * len(blocks)
    if nearness[1] - nearness[0] > _MANY_PLANES * sweeps.plane:
        seen = _looked_at(strips, prepared, nearness, sweeps, kernels, threads)
        spans = _spans(s, blocks, [*seen, *[np.empty(0, np.float32)] * len(holes)], nearness)
    for block, span in zip(blocks, spans, strict=True):
        swept, _ = sweep_planes(
            crop_frame(small, _scaled(block, sweeps.shrink)), span, sweeps.plane, kernels, threads
        )
        here = s[block]
        s[block] = np.where(np.isfinite(here), here, enlarge_blocks(swept, sweeps.shrink, here.shape))
    return s


def _looked_at(
    strips: list[Block],
    prepared: PreparedFrame,
    nearness: tuple[float, float],
    sweeps: SweepGrid,
    kernels: Kernels,
    threads: int,
) -> list[NDArray[np.float32]]:
    """(N,) nearness of what a look at half the size sees clearly in each strip."""
    half = sweeps.shrink_frame(prepared, 2)
    splines = tuple(kernels.spline_coefficients(image, threads=threads) for image in half.images)
    half = replace(half, coefficients=splines)
    return [
        find_reliable_matches(crop_frame(half, _scaled(strip, 2 * sweeps.shrink)), nearness, 2 * sweeps.plane, kernels, threads)
        for strip in strips
    ]  # fmt: skip


def _spans(
    s: NDArray[np.float32],
    blocks: list[Block],
    seen: Sequence[NDArray[np.float32]],
    nearness: tuple[float, float],
) -> list[tuple[float, float]]:
    """(far, near) to sweep each block between: about what is known in and near it, and what was seen there.

    A block that says nothing goes by all that is known; where nothing is known, all of ``nearness`` is swept.
    """
    everything = robust_range(s[np.isfinite(s)]) or nearness
    spans = []
    for block, clear in zip(blocks, seen, strict=True):
        here = s[block]
        parts = [
            span for span in (robust_range(here[np.isfinite(here)]), robust_range(clear)) if span is not None
        ]
        far, near = zip(*(parts or [everything]), strict=True)
        spans.append((max(min(far), nearness[0]), min(max(near), nearness[1])))
    return spans


def _scaled(block: Block, shrink: int) -> Block:
    rows, columns = (slice(part.start // shrink, -(-part.stop // shrink)) for part in block)
    return rows, columns
