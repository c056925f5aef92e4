"""Projected patterns other than the paper's dots: square cells, stripes of random widths, blue noise.

They are what other makers project; the simulator offers them, so that the matcher is tried on all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Mask

_FEWEST, _MOST = 1, 4
"""Widths of stripes, in cells."""


def draw_cells(size_px: tuple[int, int], cell_px: float, seed: int) -> Mask:
    """Return (H, W) square cells, each lit or dark with the same probability."""
    width, height = size_px
    rows, columns = _index_cells(height, cell_px), _index_cells(width, cell_px)
    lit = np.random.default_rng([seed, 41]).random((rows[-1] + 1, columns[-1] + 1)) < 0.5
    return lit[rows[:, None], columns]


def draw_stripes(size_px: tuple[int, int], cell_px: float, seed: int) -> Mask:
    """Return (H, W) rows of cells, each with lit and dark stripes of random widths, so that no line runs through."""
    width, height = size_px
    rows, columns = _index_cells(height, cell_px), _index_cells(width, cell_px)
    rng = np.random.default_rng([seed, 42])
    lit = np.empty((rows[-1] + 1, columns[-1] + 1), bool)
    for row in lit:
        widths = rng.integers(_FEWEST, _MOST + 1, len(row))
        row[:] = np.repeat(np.arange(len(row)) % 2 == rng.integers(2), widths)[: len(row)]
    return lit[rows[:, None], columns]


def draw_noise(size_px: tuple[int, int], cell_px: float, seed: int) -> Mask:
    """Return (H, W) blue noise in two levels: grains of about ``cell_px`` without a grid and without large patches.

    White noise without its frequencies beyond those of grains of this size and below a third of them is cut at its
    median; see Ulichney, Proc. IEEE 76(1), 1988, doi:10.1109/5.3288.
    """
    width, height = size_px
    white = np.random.default_rng([seed, 43]).standard_normal((height, width))
    along, across = np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)
    frequency = np.hypot(along, across) * 2 * cell_px  # 1: a lit and a dark grain
    kept = np.fft.rfft2(white) * ((frequency > 1 / 3) & (frequency < 1.5))
    grains: NDArray[np.float64] = np.fft.irfft2(kept, s=(height, width))
    return grains > np.median(grains)


def _index_cells(extent_px: int, cell_px: float) -> NDArray[np.int64]:
    """Return the cell of each pixel."""
    return (np.arange(extent_px) / cell_px).astype(np.int64)


GRAIN_PATTERNS: Mapping[str, Callable[[tuple[int, int], float, int], Mask]] = {
    "cells": draw_cells,
    "stripes": draw_stripes,
    "noise": draw_noise,
}
"""Pattern → function of the projector's size, of the grains' size and of the seed."""
