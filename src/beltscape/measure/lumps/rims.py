"""What lies along the rims of regions: how much is hidden, how clear they are, where the frame cuts them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.measure.lumps.raster import Raster

_STEP_CELLS = 1.0
"""A neighbour that is nearer by more than so many cells' widths at the rim hides the region there."""


@dataclass(frozen=True, slots=True, eq=False)
class Rims:
    """Sums over the rims of N + 1 regions, numbered from 0."""

    length: NDArray[np.float64]
    """(N + 1,) pairs of a cell within and one beyond."""
    hidden: NDArray[np.float64]
    """(N + 1,) of them those where the one beyond is nearer."""
    strength: NDArray[np.float64]
    """(N + 1,) summed probability of an outline."""
    open: NDArray[np.bool_]
    """(N + 1,) whether one beyond is out of what was measured, or the frame ends."""

    @property
    def hidden_share(self) -> NDArray[np.float64]:
        """(N + 1,) 0..1."""
        return self.hidden / np.maximum(self.length, 1)


def rims_of(raster: Raster, labels: NDArray[np.int64], outline: NDArray[np.float32], count: int) -> Rims:
    """Of regions numbered 0 to ``count`` (R, C), with the probability of an outline (R, C)."""
    length, hidden, strong = (np.zeros(count + 1) for _ in range(3))
    beyond = np.pad(_outer(raster.measured), 1, constant_values=True)
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


def _outer(measured: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(R, C) cells that were not measured and lie at the edge of the picture: the frame ends before them."""
    gaps, _ = ndimage.label(~measured)  # pyright: ignore[reportGeneralTypeIssues]
    edge = np.unique(np.concatenate([gaps[0], gaps[-1], gaps[:, 0], gaps[:, -1]]))
    return np.isin(gaps, edge[edge > 0])
