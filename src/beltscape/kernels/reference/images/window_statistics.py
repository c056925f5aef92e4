"""Statistics of windows: the reference of `window_means`, `window_minima` and `plane_slopes`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.kernels.images.window_statistics import (
    LEAST_SHARE,
    LEAST_SPREAD,
    SLOPE_SIDE,
    FieldInput,
    WindowsInput,
)
from beltscape.kernels.reference.images.window_sums import WindowSums, bands


def window_means(given: WindowsInput) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return share and mean, (K, H) each."""
    field, cells, sides = given.field, (given.rows, given.columns), given.sides.tolist()
    reach = max(sides) // 2
    shares, means = np.empty((2, len(sides), len(cells[0])))
    for own, near in bands(cells, reach, len(field)):
        padded = np.pad(field[near], reach, mode="edge")
        known = np.isfinite(padded)
        counts = WindowSums(known[None].astype(np.int64))
        totals = WindowSums(np.where(known, padded, 0.0)[None])
        at = (cells[0][own] - near.start + reach, cells[1][own] + reach)
        for k, side in enumerate(sides):
            share, total = counts.at(at, side)[0] / side**2, totals.at(at, side)[0] / side**2
            shares[k, own] = share
            means[k, own] = np.where(share > LEAST_SHARE, total / np.maximum(share, LEAST_SHARE), np.nan)
    return shares, means


def window_minima(given: WindowsInput) -> tuple[NDArray[np.float64]]:
    """Return the least values (K, H)."""
    field, cells, sides = given.field, (given.rows, given.columns), given.sides.tolist()
    known = np.where(np.isfinite(field), field, np.inf)
    low = np.stack([ndimage.minimum_filter(known, side, mode="nearest")[cells] for side in sides])
    return (np.where(np.isfinite(low), low, np.nan),)


def plane_slopes(given: FieldInput) -> tuple[NDArray[np.float64]]:
    """Return the slopes (2, Ny, Nx)."""
    (field,) = given
    finite = np.isfinite(field)
    measured, z = finite.astype(np.float64), np.where(finite, field, 0.0)
    k = np.arange(SLOPE_SIDE) - SLOPE_SIDE // 2
    even, odd, square = np.ones(SLOPE_SIDE), k.astype(np.float64), (k * k).astype(np.float64)

    def moment(
        values: NDArray[np.float64], down: NDArray[np.float64], across: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        part = ndimage.correlate1d(values, down, axis=0, mode="constant")
        return np.asarray(ndimage.correlate1d(part, across, axis=1, mode="constant"), np.float64)

    number = np.maximum(moment(measured, even, even), 1.0)
    x, y = moment(measured, even, odd), moment(measured, odd, even)
    total, sum_x, sum_y = moment(z, even, even), moment(z, even, odd), moment(z, odd, even)
    xx = moment(measured, even, square) - x * x / number
    yy = moment(measured, square, even) - y * y / number
    xy = moment(measured, odd, odd) - x * y / number
    xz, yz = sum_x - x * total / number, sum_y - y * total / number
    spread = xx * yy - xy * xy
    sound = (spread > LEAST_SPREAD * xx * yy) & (number >= SLOPE_SIDE) & finite
    spread = np.where(sound, spread, 1.0)
    slope = np.stack([xz * yy - yz * xy, yz * xx - xz * xy]) / spread
    return (np.where(sound, slope, 0.0),)
