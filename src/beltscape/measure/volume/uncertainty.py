"""The standard uncertainty of a volume, combined from its contributions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.belt.empty_belt import Belt
from beltscape.measure.holes.fill import Filled
from beltscape.measure.volume.box import IntegrationWeights
from beltscape.measure.volume.load import Load

STEP_SLOPE = float(np.tan(np.deg2rad(60.0)))
"""A surface steeper than this slope is a step."""
EDGE_PX = 0.1
"""σ of the position of steps, in pixels, common to all: a matcher's bias at edges is the same at all of them."""
_COMMON_SHARE = 0.2
"""Share of the holes' σ that is common to all holes, because one network filled them all and occluded parts are
alike; set on captures that the networks were not trained on."""
_PATCH_CELLS = 8
"""Errors within a hole are correlated only within blocks of this side, since the holes of a heap are connected."""


@dataclass(frozen=True, slots=True)
class VolumeSigma:
    """Contributions to a volume's uncertainty, one standard deviation each, mm³."""

    noise_mm3: float
    """Noise of the loaded depth map, correlated over patches as large as on the empty belt."""
    belt_mm3: float
    """Uncertainty of the empty belt's cross-section and deviation."""
    holes_mm3: float
    """Uncertainty of the interpolated cells: fully correlated within a hole's block, a share common to all."""
    edges_mm3: float
    """The vertical area of all steps times a tenth of a pixel, common to the whole box."""
    drift_mm3: float
    """Slow errors of the depth map on the empty belt and of cameras that moved, common to the whole box."""
    unseen_mm3: float = 0.0
    """Volume beside a box that covers only part of the belt's width, were it loaded alike; 0 for a given box."""

    @property
    def total_mm3(self) -> float:
        """Return the root of the sum of squares."""
        parts = (
            self.noise_mm3,
            self.belt_mm3,
            self.holes_mm3,
            self.edges_mm3,
            self.drift_mm3,
            self.unseen_mm3,
        )
        return float(np.sqrt(sum(part**2 for part in parts)))


def compute_volume_sigma(
    load: Load,
    filled: Filled,
    weights: IntegrationWeights,
    belt: Belt,
    factor: NDArray[np.float64] | None = None,
) -> VolumeSigma:
    """Return the contributions to σ of the weighted integral of ``filled``.

    ``factor`` (Ny, Nx), where given, multiplies the weights, as for moments of the load.
    """
    grid = load.grid
    cell_mm = grid.cell_mm
    weight = np.outer(weights.along, weights.across)
    if factor is not None:
        weight = weight * factor
    patch_mm2 = (belt.correlation_px * cell_mm) ** 2
    patch_cells = max(patch_mm2 / cell_mm**2, 1.0)
    noise = np.sqrt(np.sum((weight * np.nan_to_num(load.noise_mm)) ** 2) * patch_cells)
    belt_sigma = _compute_belt_sigma(weight, belt.surface_sigma_mm(grid.x_mm, grid.y_mm), grid.x_mm, belt)
    holes = _compute_hole_sigma(weight * np.where(load.measured, 0.0, filled.sigma_mm), ~load.measured)
    # the narrow gaps between neighbouring points are holes too, with a smaller σ
    narrow = load.measured & filled.hole
    holes = np.hypot(holes, _compute_hole_sigma(weight * np.where(narrow, filled.sigma_mm, 0.0), narrow))
    edges = EDGE_PX * cell_mm * abs(_sum_step_area_mm2(filled, weights, cell_mm, factor))
    drift = belt.drift_mm * abs(float(weight.sum()))
    return VolumeSigma(float(noise), belt_sigma, float(holes), float(edges), float(drift))


def _compute_belt_sigma(
    weight: NDArray[np.float64], sigma_mm: NDArray[np.float64], x_mm: NDArray[np.float64], belt: Belt
) -> float:
    """Return σ of the belt's integral: fully correlated along each node of its section, independent across."""
    node = np.rint(np.interp(x_mm, belt.x_mm, np.arange(len(belt.x_mm)))).astype(np.intp)
    return float(np.sqrt(np.sum(np.bincount(node, (weight * sigma_mm).sum(axis=0)) ** 2)))


def _compute_hole_sigma(sigma_mm3: NDArray[np.float64], hole: NDArray[np.bool_]) -> float:
    """Return σ of a sum over holes: fully correlated within each block of a hole, with a share common to all."""
    label = np.zeros(hole.shape, np.int32)
    ndimage.label(hole, np.ones((3, 3)), output=label)
    rows, columns = int(hole.shape[0]), int(hole.shape[1])
    block = (np.arange(rows)[:, None] // _PATCH_CELLS) * (columns // _PATCH_CELLS + 1) + np.arange(columns)[
        None
    ] // _PATCH_CELLS
    own = np.unique(label[hole].astype(np.int64) * (block.max() + 1) + block[hole], return_inverse=True)[1]
    sums = np.bincount(own.ravel(), sigma_mm3[hole]) if hole.any() else np.zeros(1)
    return float(np.sqrt(np.sum(sums**2) * (1 - _COMMON_SHARE**2) + (_COMMON_SHARE * sums.sum()) ** 2))


def _sum_step_area_mm2(
    filled: Filled, weights: IntegrationWeights, cell_mm: float, factor: NDArray[np.float64] | None
) -> float:
    """Return the vertical area of the steps within the box, weighted by the factor."""
    own = np.ix_(weights.along > 0, weights.across > 0)
    inside = filled.value_mm[own]
    times = np.ones(inside.shape) if factor is None else factor[own]
    total = 0.0
    for axis in (0, 1):
        rise = np.abs(np.diff(inside, axis=axis))
        here = times[1:] if axis == 0 else times[:, 1:]
        total += float(np.sum(np.where(rise > STEP_SLOPE * cell_mm, rise * here, 0.0)))
    return cell_mm * total
