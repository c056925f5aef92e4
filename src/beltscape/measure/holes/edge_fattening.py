"""Edge fattening: the excess height of the last measured cells above a drop.

A matcher compares windows. Where a window lies across an edge, the nearer and better lit side often dominates, so
that this side comes out up to a pixel too wide: most beside low steps onto a dull belt, hardly beside tall ones,
whose shadow is not matched. On simulated captures the last cells above a step are too high by 5 to 10 % of the step,
by 30 to 60 % along a module's base plate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.kernels.arrays import CellIndices
from beltscape.learned.network import Network
from beltscape.measure.holes.rims import fit_gradients

_REACHES = (1, 2, 4, 8, 16, 32)
"""Half sides in cells of the windows in which the lowest and the highest measured cell are found."""
_STEEP = 0.8
"""A descent within two cells or more is a drop if its rise over run exceeds this."""
_OPEN_CELLS = (3, 5, 11, 25)
"""Cells across the windows in which the share of hole cells is computed."""
_NEAR_CELLS = (5, 9)
"""Cells across the windows in which a cell's height is compared with its neighbours'."""
_VIEW_CELLS = 13
"""Cells across the window in which the direction of descent is estimated."""
_BARE_CELLS = 3.0
"""Unit of heights over the belt, as in `features`."""
_MOST = 4.0
"""Ratios are clipped to this."""
_LIMITS = (-0.5, 1.0)
"""Limits of the predicted share of the drop."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeFattening:
    """B measured cells that touch a hole above a drop."""

    cells: CellIndices
    """Row and column, (B,) each."""
    drop_mm: NDArray[np.float64]
    """(B,) height over the lowest measured cell within the widest window in which the descent is steep."""
    features: dict[str, NDArray[np.floating]]
    """(B,) by name: angles, shares, logarithms."""

    def predict_excess_mm(self, network: Network) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Predict by how many millimetres (B,) the cells' mean heights are too high, and σ of that."""
        share, sigma = network.predict_mean_and_sigma(self.features)
        return self.drop_mm * np.clip(share, *_LIMITS), self.drop_mm * np.minimum(sigma, 1.0)


def find_edge_fattening(
    value_mm: NDArray[np.float64], ray_slope: NDArray[np.float64], cell_mm: float
) -> EdgeFattening:
    """Find the cells in a field (Ny, Nx) with NaN in its holes; ``ray_slope`` (2, Ny, Nx) are slopes in x and y."""
    hole = ~np.isfinite(value_mm)
    rows, columns = np.nonzero(np.asarray(ndimage.binary_dilation(hole, np.ones((3, 3))), bool) & ~hole)
    own = value_mm[rows, columns]
    drop = np.zeros(len(own))
    features: dict[str, NDArray[np.floating]] = {}
    for reach in _REACHES:
        low = ndimage.minimum_filter(np.where(hole, np.inf, value_mm), 2 * reach + 1)[rows, columns]
        high = ndimage.maximum_filter(np.where(hole, -np.inf, value_mm), 2 * reach + 1)[rows, columns]
        down = (own - low) / (reach * cell_mm)
        features[f"descent within {reach}"] = np.arctan(down)
        features[f"ascent within {reach}"] = np.arctan((high - own) / (reach * cell_mm))
        features[f"lowest within {reach}"] = np.arctan(low / (_BARE_CELLS * cell_mm))
        features[f"log drop within {reach}"] = np.log1p((own - low) / cell_mm)
        if reach > 1:
            drop = np.where(down > _STEEP, own - low, drop)
    cells = (rows, columns)
    for side in _OPEN_CELLS:
        open_share = np.asarray(ndimage.uniform_filter(hole.astype(float), side))
        features[f"hole share within {side}"] = open_share[cells]
    features["ray slope downhill"] = _project_ray_slope(value_mm, ray_slope, cells)
    features["ray slope"] = np.hypot(ray_slope[0], ray_slope[1])[cells]
    features["surface slope"] = np.arctan(np.hypot(*fit_gradients(value_mm, cell_mm))[cells])
    for side in _NEAR_CELLS:
        mean, spread = _compute_window_statistics(value_mm, side)
        features[f"relief within {side}"] = np.arctan(spread[cells] / (side * cell_mm))
        above_mean = (own - mean[cells]) / (spread[cells] + 0.01 * cell_mm)
        features[f"height over mean within {side}"] = np.clip(above_mean, -_MOST, _MOST)
    above = drop > 0
    chosen = {name: values[above] for name, values in features.items()}
    return EdgeFattening((rows[above], columns[above]), drop[above], chosen)


def _project_ray_slope(
    value_mm: NDArray[np.float64], ray_slope: NDArray[np.float64], cells: CellIndices
) -> NDArray[np.float64]:
    """Return the rays' slope (B,) along the direction in which the measured surface around a cell descends."""
    known = np.isfinite(value_mm)
    height, mass = np.where(known, value_mm - np.nanmean(value_mm), 0.0), known.astype(float)
    steps, ones = np.arange(_VIEW_CELLS, dtype=np.float64) - _VIEW_CELLS // 2.0, np.ones(_VIEW_CELLS)

    def correlate(
        field: NDArray[np.float64], down: NDArray[np.float64], across: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        part = ndimage.correlate1d(field, down, axis=0, mode="constant")
        return np.asarray(ndimage.correlate1d(part, across, axis=1, mode="constant"))[cells]

    mean = correlate(height, ones, ones) / np.maximum(correlate(mass, ones, ones), 1.0)
    x = correlate(height, ones, steps) - mean * correlate(mass, ones, steps)
    y = correlate(height, steps, ones) - mean * correlate(mass, steps, ones)
    return -(x * ray_slope[0][cells] + y * ray_slope[1][cells]) / (np.hypot(x, y) + 1e-9)


def _compute_window_statistics(
    value_mm: NDArray[np.float64], side: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return mean and standard deviation (Ny, Nx) of the measured cells in a window."""
    known = np.isfinite(value_mm)
    middle = float(np.nanmean(value_mm))
    height = np.where(known, value_mm - middle, 0.0)
    share = np.maximum(ndimage.uniform_filter(known.astype(float), side), 1e-3)
    mean = ndimage.uniform_filter(height, side) / share
    square = ndimage.uniform_filter(height**2, side) / share - mean**2
    return mean + middle, np.sqrt(np.maximum(square, 0.0))
