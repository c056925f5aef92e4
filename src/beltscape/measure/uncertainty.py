"""One standard deviation of a volume, put together from its causes."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from beltscape.measure.belt import Belt
from beltscape.measure.box import Weights
from beltscape.measure.holes import Filled
from beltscape.measure.load import Load

_STEP = np.tan(np.deg2rad(60.0))
_EDGE_PX = 0.1
"""Steps are placed this well, in pixels, all alike: the raster of points cannot tell better."""
_COMMON = 0.15
"""Share of the holes' σ that all holes have in common: one rule filled them all."""


def volume_sigma(load: Load, filled: Filled, weights: Weights, belt: Belt) -> float:
    """σ (mm³) of the integral of ``filled`` under the weights: the root of a sum of squares.

    noise      the cells' shared noise, over patches as large as the depth map's errors are correlated on the
               empty belt
    sampling   each measured cell's own scatter of points, independent from cell to cell
    holes      the interpolated cells, wholly correlated within a hole, a share of it common to all holes
    edges      the area of all steps times a tenth of a pixel, common to the whole box
    drift      slow errors of the depth map on the empty belt, common to the whole box
    """
    cell_mm = load.grid.cell_mm
    weight = np.outer(weights.along, weights.across)
    noise = np.nan_to_num(load.noise_mm)
    shared = float(np.sum(weight * noise**2)) * (belt.correlation_px * cell_mm) ** 2
    own = np.where(load.measured, filled.sigma_mm, 0.0) ** 2 - noise**2
    sampling = float(np.sum(weight**2 * np.clip(own, 0, None)))
    label = np.zeros(filled.hole.shape, np.int32)
    ndimage.label(~load.measured, np.ones((3, 3)), output=label)
    sums = np.bincount(label.ravel(), (weight * filled.sigma_mm).ravel())[1:]
    holes = float(np.sum(sums**2)) + (_COMMON * float(sums.sum())) ** 2
    edges = (_EDGE_PX * cell_mm * _step_area_mm2(filled, weights, cell_mm)) ** 2
    drift = (belt.drift_mm * float(weight.sum())) ** 2
    return float(np.sqrt(shared + sampling + holes + edges + drift))


def _step_area_mm2(filled: Filled, weights: Weights, cell_mm: float) -> float:
    """Upright area of the steps within the box."""
    inside = filled.value_mm[np.ix_(weights.along > 0, weights.across > 0)]
    rises = [np.abs(np.diff(inside, axis=axis)) for axis in (0, 1)]
    return cell_mm * sum(float(rise[rise > _STEP * cell_mm].sum()) for rise in rises)
