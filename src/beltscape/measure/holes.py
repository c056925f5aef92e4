"""Filling of occlusion holes: heights with σ for cells that were not measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels import load_on_processor
from beltscape.learned.network import Network
from beltscape.learned.registry import load_network


@dataclass(frozen=True, slots=True, eq=False)
class Filled:
    """A field without holes."""

    value_mm: NDArray[np.float64]
    """(Ny, Nx) measured values, and predicted ones in the holes."""
    sigma_mm: NDArray[np.float64]
    """(Ny, Nx) one standard deviation; in the holes that of the prediction."""
    hole: NDArray[np.bool_]
    """(Ny, Nx) whether a cell was not measured."""

    def cut(self, rows: slice) -> Filled:
        """Return these rows alone."""
        return Filled(self.value_mm[rows], self.sigma_mm[rows], self.hole[rows])


def fill_holes(
    value_mm: NDArray[np.float64],
    sigma_mm: NDArray[np.float64],
    pinhole: NDArray[np.bool_],
    cell_mm: float,
    ray_slope: NDArray[np.float64] | None = None,
    *,
    rows: slice = slice(None),
    network: Network | None = None,
) -> Filled:
    """Fill the NaN cells of a field (Ny, Nx) of heights over the belt.

    For each hole cell the rims of its hole are found along five lines: across, along, both diagonals, and the core's
    line of sight (``ray_slope`` (2, Ny, Nx) are the rays' slopes in x and y; None for vertical rays). A quadratic
    through the measured cells around it predicts a smooth surface, which holds where these cells follow it.
    Otherwise the height is open within a range that grows with the height difference of the rims and the roughness
    of the measured surface. A small network predicts from dimensionless features the mean and σ of the height in
    this range. It (``network``; None for Beltscape's own) was fitted by the mean square to simulated heaps and
    modules with known truth (tools/training), so that sums over many cells, such as a volume, are unbiased.

    No cell is put below both its lowest rim and the belt, or above both its highest rim and the smooth surface.
    Outside the outermost measured cells the nearest value is used. ``pinhole`` (Ny, Nx) marks gaps between the points
    of neighbouring pixels. Holes outside ``rows`` are not filled.

    Raises
    ------
    ValueError
        if nothing was measured.
    """
    hole = ~np.isfinite(value_mm)
    if hole.all():
        raise ValueError("nothing to interpolate from")
    if not hole[rows].any():
        return Filled(value_mm, sigma_mm, hole)
    ray_slope = np.zeros((2, *hole.shape)) if ray_slope is None else ray_slope
    network = network or load_network("holes")
    weights = network.features, network.limits, network.layers
    planes = value_mm, sigma_mm
    filled = load_on_processor().fill_holes(planes, pinhole, ray_slope, cell_mm, weights, rows=rows)
    return Filled(filled.value, filled.sigma, hole)
