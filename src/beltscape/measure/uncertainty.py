"""One standard deviation of a volume, put together from its causes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.belt_model import Belt
from beltscape.measure.box import Weights
from beltscape.measure.holes.fill import Filled
from beltscape.measure.load import Load

STEP = float(np.tan(np.deg2rad(60.0)))
"""Rise over run from which on a surface is a step."""
_EDGE_PX = 0.1
"""Steps are placed this well, in pixels, all alike: a matcher's habit at edges is the same at all of them."""
_COMMON = 0.2
"""Share of the holes' σ that all holes have in common: the same rules filled them all, and what cameras
could not see is alike; set on captures that the networks had not seen."""
_PATCH = 8
"""Cells across the blocks beyond which errors of one hole do not go together: holes of a heap hang together."""


@dataclass(frozen=True, slots=True)
class VolumeSigma:
    """Causes of a volume's uncertainty, one standard deviation each, mm³."""

    noise_mm3: float
    """Of the loaded depth map, over patches as large as its errors go together on the empty belt."""
    belt_mm3: float
    """Of the learned belt's cross-section and deviation."""
    holes_mm3: float
    """Of the interpolated cells: wholly correlated within a hole's block, a share of it common to all."""
    edges_mm3: float
    """The upright area of all steps times a third of a pixel, common to the whole box."""
    drift_mm3: float
    """Slow errors of the depth map on the empty belt and of cameras that moved, common to the whole box."""
    unseen_mm3: float = 0.0
    """What a belt loaded alike carries beside a box that holds only part of its width; 0 for a given box."""

    @property
    def total_mm3(self) -> float:
        """Root of the sum of squares."""
        parts = (self.noise_mm3, self.belt_mm3, self.holes_mm3, self.edges_mm3, self.drift_mm3, self.unseen_mm3)
        return float(np.sqrt(sum(part**2 for part in parts)))


def volume_sigma(
    load: Load,
    filled: Filled,
    weights: Weights,
    belt: Belt,
    factor: NDArray[np.float64] | None = None,
) -> VolumeSigma:
    """σ of the integral of ``filled`` under the weights, by causes.

    ``factor`` (Ny, Nx), where given, is what each millimetre of height counts for: so for moments of the load.
    """
    grid = load.grid
    cell_mm = grid.cell_mm
    weight = np.outer(weights.along, weights.across)
    if factor is not None:
        weight = weight * factor
    patch_mm2 = (belt.correlation_px * cell_mm) ** 2
    patch_cells = max(patch_mm2 / cell_mm**2, 1.0)
    noise = np.sqrt(np.sum((weight * np.nan_to_num(load.noise_mm)) ** 2) * patch_cells)
    below = _node_sums(weight, belt.surface_sigma_mm(grid.x_mm, grid.y_mm), grid.x_mm, belt)
    holes = _patches(weight * np.where(load.measured, 0.0, filled.sigma_mm), ~load.measured)
    # the narrow gaps between neighbouring points are holes too, of which less is open
    narrow = load.measured & filled.hole
    holes = np.hypot(holes, _patches(weight * np.where(narrow, filled.sigma_mm, 0.0), narrow))
    edges = _EDGE_PX * cell_mm * abs(_step_area_mm2(filled, weights, cell_mm, factor))
    drift = belt.drift_mm * abs(float(weight.sum()))
    return VolumeSigma(float(noise), below, float(holes), float(edges), float(drift))


def _node_sums(
    weight: NDArray[np.float64], sigma_mm: NDArray[np.float64], x_mm: NDArray[np.float64], belt: Belt
) -> float:
    """σ of the belt's integral: wholly correlated along each node of its cross-section, independent across."""
    node = np.rint(np.interp(x_mm, belt.x_mm, np.arange(len(belt.x_mm)))).astype(np.intp)
    return float(np.sqrt(np.sum(np.bincount(node, (weight * sigma_mm).sum(axis=0)) ** 2)))


def _patches(doubt_mm3: NDArray[np.float64], hole: NDArray[np.bool_]) -> float:
    """σ of a sum over holes, wholly correlated within each block of each, partly in common."""
    label = np.zeros(hole.shape, np.int32)
    ndimage.label(hole, np.ones((3, 3)), output=label)
    rows, columns = hole.shape
    block = (np.arange(rows)[:, None] // _PATCH) * (columns // _PATCH + 1) + np.arange(columns)[
        None
    ] // _PATCH
    own = np.unique(label[hole].astype(np.int64) * (block.max() + 1) + block[hole], return_inverse=True)[1]
    sums = np.bincount(own.ravel(), doubt_mm3[hole]) if hole.any() else np.zeros(1)
    return float(np.sqrt(np.sum(sums**2) * (1 - _COMMON**2) + (_COMMON * sums.sum()) ** 2))


def _step_area_mm2(
    filled: Filled, weights: Weights, cell_mm: float, factor: NDArray[np.float64] | None
) -> float:
    """Upright area of the steps within the box, each times the factor there."""
    own = np.ix_(weights.along > 0, weights.across > 0)
    inside = filled.value_mm[own]
    times = np.ones(inside.shape) if factor is None else factor[own]
    total = 0.0
    for axis in (0, 1):
        rise = np.abs(np.diff(inside, axis=axis))
        here = times[1:] if axis == 0 else times[:, 1:]
        total += float(np.sum(np.where(rise > STEP * cell_mm, rise * here, 0.0)))
    return cell_mm * total
