"""The last measured cells beside drops: how much of their area lies beyond the edge.

A matcher compares windows, and where one lies across an edge the nearer, better lit side often wins: that side comes
out up to a pixel too wide, most beside low steps onto a dull belt, hardly beside tall ones, whose shadow nobody
matches. On simulated captures the last cells above a step so hold 5 to 10 % of it too much, 30 to 60 % along a
module's base plate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.kernels.arrays import CellIndices
from beltscape.measure.holes.rims import gradients
from beltscape.measure.network import Network

_REACHES = (1, 2, 4, 8, 16, 32)
"""Cells within which the lowest and the highest measured cell count."""
_STEEP = 0.8
"""Rise over run from which on what lies within a reach of two cells or more is a drop."""
_OPEN_CELLS = (3, 5, 11, 25)
_NEAR_CELLS = (5, 9)
_VIEW_CELLS = 13
"""Cells across the window in which the way down is found."""
_BARE_CELLS = 3.0
_MOST = 4.0
_LIMITS = (-0.5, 1.0)
"""Shares that can be."""


@dataclass(frozen=True, slots=True, eq=False)
class Brinks:
    """B measured cells that touch a hole and stand above a drop."""

    place: CellIndices
    """Row and column, (B,) each."""
    drop_mm: NDArray[np.float64]
    """(B,) down to the lowest measured cell within the widest reach in which it is steep."""
    features: NDArray[np.float32]
    """(B, 36) angles, shares, logarithms."""

    def beyond(self, network: Network) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(B,) millimetres by which the cells' mean heights are too high, and their standard deviation."""
        share, sigma = network.predict_mean_and_sigma(self.features)
        return self.drop_mm * np.clip(share, *_LIMITS), self.drop_mm * np.minimum(sigma, 1.0)


def brinks(value_mm: NDArray[np.float64], lean: NDArray[np.float64], cell_mm: float) -> Brinks:
    """Find them in a field (Ny, Nx) with NaN in its holes; ``lean`` (2, Ny, Nx): tangents of the rays' slant."""
    hole = ~np.isfinite(value_mm)
    rows, columns = np.nonzero(np.asarray(ndimage.binary_dilation(hole, np.ones((3, 3))), bool) & ~hole)
    own = value_mm[rows, columns]
    drop, found = np.zeros(len(own)), []
    for reach in _REACHES:
        low = ndimage.minimum_filter(np.where(hole, np.inf, value_mm), 2 * reach + 1)[rows, columns]
        high = ndimage.maximum_filter(np.where(hole, -np.inf, value_mm), 2 * reach + 1)[rows, columns]
        down = (own - low) / (reach * cell_mm)
        found += [np.arctan(down), np.arctan((high - own) / (reach * cell_mm))]
        found += [np.arctan(low / (_BARE_CELLS * cell_mm)), np.log1p((own - low) / cell_mm)]
        if reach > 1:
            drop = np.where(down > _STEEP, own - low, drop)
    place = (rows, columns)
    found += [np.asarray(ndimage.uniform_filter(hole.astype(float), s))[place] for s in _OPEN_CELLS]
    found += [_viewed_down(value_mm, lean, place), np.hypot(lean[0], lean[1])[place]]
    found.append(np.arctan(np.hypot(*gradients(value_mm, cell_mm))[place]))
    for side in _NEAR_CELLS:
        mean, spread = _near(value_mm, side)
        found.append(np.arctan(spread[place] / (side * cell_mm)))
        found.append(np.clip((own - mean[place]) / (spread[place] + 0.01 * cell_mm), -_MOST, _MOST))
    above = drop > 0
    table = np.stack(found, axis=1).astype(np.float32)
    return Brinks((rows[above], columns[above]), drop[above], table[above])


def _viewed_down(
    value_mm: NDArray[np.float64], lean: NDArray[np.float64], place: CellIndices
) -> NDArray[np.float64]:
    """(B,) tangent by which the rays come down the way the measured surface about a cell falls."""
    known = np.isfinite(value_mm)
    height, mass = np.where(known, value_mm - np.nanmean(value_mm), 0.0), known.astype(float)
    steps, ones = np.arange(_VIEW_CELLS) - _VIEW_CELLS // 2.0, np.ones(_VIEW_CELLS)

    def summed(
        field: NDArray[np.float64], down: NDArray[np.float64], across: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        part = ndimage.correlate1d(field, down, axis=0, mode="constant")
        return np.asarray(ndimage.correlate1d(part, across, axis=1, mode="constant"))[place]

    mean = summed(height, ones, ones) / np.maximum(summed(mass, ones, ones), 1.0)
    x = summed(height, ones, steps) - mean * summed(mass, ones, steps)
    y = summed(height, steps, ones) - mean * summed(mass, steps, ones)
    return -(x * lean[0][place] + y * lean[1][place]) / (np.hypot(x, y) + 1e-9)


def _near(value_mm: NDArray[np.float64], side: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(Ny, Nx) mean and standard deviation of the measured cells in a window."""
    known = np.isfinite(value_mm)
    middle = float(np.nanmean(value_mm))
    height = np.where(known, value_mm - middle, 0.0)
    share = np.maximum(ndimage.uniform_filter(known.astype(float), side), 1e-3)
    mean = ndimage.uniform_filter(height, side) / share
    square = ndimage.uniform_filter(height**2, side) / share - mean**2
    return mean + middle, np.sqrt(np.maximum(square, 0.0))
