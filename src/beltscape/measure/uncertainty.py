"""One standard deviation of a volume, put together from its causes."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from beltscape.measure.belt import Belt
from beltscape.measure.box import Weights
from beltscape.measure.holes import Filled
from beltscape.measure.load import Load


def volume_sigma(load: Load, filled: Filled, weights: Weights, belt: Belt, pixel_mm: float) -> float:
    """σ (mm³) of the integral of ``filled`` under the weights: the root of the sum of four squares.

    noise      the cells' shared noise, over patches as large as the depth map's errors are correlated on the
               empty belt
    sampling   each measured cell's own scatter of points, independent from cell to cell
    holes      the interpolated cells, wholly correlated within a hole, independent between holes
    drift      slow errors of the depth map on the empty belt, taken as common to the whole box
    """
    weight = np.outer(weights.along, weights.across)
    measured = ~filled.hole
    noise = np.where(measured, load.noise_mm, 0.0)
    patch_mm2 = max((belt.correlation_px * pixel_mm) ** 2, load.grid.cell_mm**2)
    shared = float(np.sum(weight * noise**2)) * patch_mm2
    own = np.where(measured, load.sigma_mm, 0.0) ** 2 - noise**2
    sampling = float(np.sum(weight**2 * np.clip(own, 0, None)))
    label = np.zeros(filled.hole.shape, np.int32)
    ndimage.label(filled.hole, np.ones((3, 3)), output=label)
    sums = np.bincount(label.ravel(), (weight * filled.sigma_mm).ravel())[1:]
    holes = float(np.sum(sums**2))
    drift = (belt.drift_mm * float(weight.sum())) ** 2
    return float(np.sqrt(shared + sampling + holes + drift))
