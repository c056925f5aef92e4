"""Fusion of several frames of the same belt into one surface.

Dots, markers and shadows fall on other parts of the material in every frame, so frames complement each other. Where
frames disagree, cells that differ from the weighted median are excluded, so that two surfaces are never averaged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import load_on_processor
from beltscape.measure.belt.reference import Layer
from beltscape.measure.surface import close_pinholes

_OUTLIER = 4.0
"""A value farther than this many σ, beyond the tolerance, from the median is excluded."""
_RANK = 0.65
"""Rank of the weighted median: slightly above a half, because of two surfaces at one position the upper is the top,
and each frame loses half a pixel of its rim."""
_TOLERANCE_CELLS = 0.35
"""Tolerated displacement, in cells: heights may differ by this times the surface's rise per cell."""


@dataclass(frozen=True, slots=True, eq=False)
class FusedRows:
    """Rows of belt, each cell fused from all frames that measured it."""

    layer: Layer
    """The fused surface, with σ and noise for independent errors of the frames."""
    single_share: NDArray[np.float64]
    """(n,) share of a row's cells that a single frame measures, averaged over the frames with the row in view."""
    frames: NDArray[np.int64]
    """(n,) number of frames with the row in view."""
    false_mm: NDArray[np.float64]
    """(n,) σ of the row's mean height from depths that may be false, in all of its frames alike."""
    scatter: Scatter
    """Differences between the frames."""


@dataclass(frozen=True, slots=True)
class Scatter:
    """Sums over cells that several frames measured, for the noise of one frame and of the fused surface."""

    cells: int = 0
    """Number of compared values of single frames."""
    single_mm2: float = 0.0
    """Sum of their squared deviations, corrected for the estimated mean."""
    claimed_mm2: float = 0.0
    """Sum of their stated variances."""
    fused_mm2: float = 0.0
    """Sum of the fused cells' variances according to the scatter of single values."""
    outliers: int = 0
    """Number of excluded values."""

    def __add__(self, other: Scatter) -> Scatter:
        return Scatter(
            self.cells + other.cells,
            self.single_mm2 + other.single_mm2,
            self.claimed_mm2 + other.claimed_mm2,
            self.fused_mm2 + other.fused_mm2,
            self.outliers + other.outliers,
        )

    @property
    def single_noise_mm(self) -> float:
        """Scatter of one frame's heights about the fused surface."""
        return float(np.sqrt(self.single_mm2 / self.cells)) if self.cells else float("nan")

    @property
    def fused_noise_mm(self) -> float:
        """Part of ``single_noise_mm`` that remains in the fused heights."""
        return float(np.sqrt(self.fused_mm2 / self.cells)) if self.cells else float("nan")


def fuse(layers: Sequence[Layer], first: int, end: int) -> FusedRows:
    """Rows ``first`` to ``end`` of the belt from all layers that have one of them; at least one layer must."""
    parts = [layer.rows(first, end) for layer in layers if layer.first < end and layer.end > first]
    columns = parts[0].height_mm.shape[1]
    shape = (len(parts), end - first, columns)
    height, sigma, noise = (np.full(shape, np.nan, np.float32) for _ in range(3))
    inside, share, ray_slope, false = np.zeros((4, *shape[:2]))
    for k, part in enumerate(parts):
        rows = slice(part.first - first, part.end - first)
        height[k, rows], sigma[k, rows], noise[k, rows] = part.height_mm, part.sigma_mm, part.noise_mm
        inside[k, rows], share[k, rows], ray_slope[k, rows] = 1, part.share, part.ray_slope
        false[k, rows] = part.false_mm
    number = np.maximum(inside.sum(axis=0).astype(np.int64), 1)
    layer, scatter = _fuse_stack(height, sigma, noise, first, ray_slope.sum(axis=0) / number)
    return FusedRows(layer, share.sum(axis=0) / number, number, false.sum(axis=0) / number, scatter)


def _fuse_stack(
    height: NDArray[np.float32],
    sigma: NDArray[np.float32],
    noise: NDArray[np.float32],
    first: int,
    ray_slope: NDArray[np.float64],
) -> tuple[Layer, Scatter]:
    """Fuse stacks (k, n, Nx) of k layers."""
    fused = load_on_processor().fuse_layers(
        (height, sigma, noise), rank=_RANK, outlier=_OUTLIER, tolerance=_TOLERANCE_CELLS
    )
    share = close_pinholes(fused.measured.view(np.bool_)).mean(axis=1)
    layer = Layer(first, fused.height, fused.sigma, fused.noise, share, ray_slope)
    cells, single, claimed, kept, outliers = (float(part) for part in fused.sums.sum(axis=0))
    typical = single / cells if cells else 0.0
    return layer, Scatter(int(cells), single, claimed, kept * typical, int(outliers))
