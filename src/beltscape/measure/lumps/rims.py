"""The rims of regions: their hidden share, the strength of their outline, and whether the frame cuts them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.measure.lumps.raster import Raster

_STEP_CELLS = 1.0
"""A neighbour nearer by more than this, in widths of a cell, hides the region at the rim."""


@dataclass(frozen=True, slots=True, eq=False)
class Rims:
    """Sums over the rims of N + 1 regions, numbered from 0."""

    length: NDArray[np.float64]
    """(N + 1,) number of pairs of a cell inside and a cell outside."""
    hidden: NDArray[np.float64]
    """(N + 1,) number of these pairs whose outer cell is nearer to the camera."""
    strength: NDArray[np.float64]
    """(N + 1,) summed probability of an outline."""
    open: NDArray[np.bool_]
    """(N + 1,) whether the region touches the border of the frame or of the measured area."""

    @property
    def hidden_share(self) -> NDArray[np.float64]:
        """Return the hidden share of the rims (N + 1,), 0..1."""
        return self.hidden / np.maximum(self.length, 1)


def measure_rims(raster: Raster, labels: NDArray[np.int64], outline: NDArray[np.float32], count: int) -> Rims:
    """Measure the rims of regions (R, C) numbered 0 to ``count``, given the probability of an outline (R, C)."""
    length, hidden, strong = (np.zeros(count + 1) for _ in range(3))
    beyond = np.pad(_border_gap_mask(raster.measured), 1, constant_values=True)
    is_open = np.zeros(count + 1, bool)
    step = _STEP_CELLS * raster.depth_mm * raster.cell_rad
    for one, two in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        apart = labels[one] != labels[two]
        strength = np.maximum(outline[one], outline[two])[apart]
        for a, b in ((one, two), (two, one)):
            own = labels[a][apart]
            nearer = (raster.depth_mm[a] - raster.depth_mm[b] > step[a])[apart]
            length += np.bincount(own, minlength=count + 1)
            hidden += np.bincount(own, nearer, count + 1)
            strong += np.bincount(own, strength, count + 1)
    rows, columns = labels.shape
    for down, right in ((0, 1), (2, 1), (1, 0), (1, 2)):
        is_open[labels[beyond[down : down + rows, right : right + columns]]] = True
    return Rims(length, hidden, strong, is_open)


def _border_gap_mask(measured: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the unmeasured cells (R, C) that are connected to the border of the frame."""
    gaps, _ = ndimage.label(~measured)
    edge = np.unique(np.concatenate([gaps[0], gaps[-1], gaps[:, 0], gaps[:, -1]]))
    return np.isin(gaps, edge[edge > 0])
