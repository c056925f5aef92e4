"""Regions of the pattern: the image divided half way between neighbouring markers (the paper's Section 2.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.stereo.markers.grid import SIDE


def compute_region_corners(center_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (9, 9, 2) lattice of the regions' corners (even, even), boundary midpoints and markers (odd, odd).

    The boundary passes through the mean of two neighbouring markers, corners are the mean of four; the outer
    boundary lies half a step beyond the outermost markers.
    """
    padded = np.pad(center_px, ((1, 1), (1, 1), (0, 0)))
    padded[0], padded[-1] = 2 * padded[1] - padded[2], 2 * padded[-2] - padded[-3]
    padded[:, 0], padded[:, -1] = 2 * padded[:, 1] - padded[:, 2], 2 * padded[:, -2] - padded[:, -3]
    lattice = np.empty((2 * SIDE + 1, 2 * SIDE + 1, 2))
    lattice[1::2, 1::2] = center_px
    lattice[0::2, 1::2] = (padded[:-1, 1:-1] + padded[1:, 1:-1]) / 2
    lattice[1::2, 0::2] = (padded[1:-1, :-1] + padded[1:-1, 1:]) / 2
    lattice[0::2, 0::2] = (padded[:-1, :-1] + padded[1:, :-1] + padded[:-1, 1:] + padded[1:, 1:]) / 4
    return lattice


def compute_region_outline(center_px: NDArray[np.float64], row: int, column: int) -> NDArray[np.float64]:
    """Return the (8, 2) outline of one region, u, v."""
    lattice = compute_region_corners(center_px)
    around = [(0, 0), (0, 1), (0, 2), (1, 2), (2, 2), (2, 1), (2, 0), (1, 0)]
    return np.array([lattice[2 * row + r, 2 * column + c] for r, c in around])
