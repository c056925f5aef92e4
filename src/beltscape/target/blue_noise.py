"""Uniformity of random dots: distances to the nearest neighbour and the power spectrum of their positions."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import NDArray

from beltscape.target.pattern import Pattern

BINS_PER_D_MIN = 8
"""Cells per d_min of the raster on which the spectrum is computed."""

FREQUENCIES = np.arange(0, 2.5001, 0.05)
"""Edges of the rings over which the spectrum is averaged, in cycles per d_min."""

LOW_FREQUENCY = 0.3
"""Limit of low frequencies in cycles per d_min: structures wider than three d_min."""


@dataclass(frozen=True, slots=True, eq=False)
class BlueNoise:
    """Measures of a pattern's uniformity."""

    d_min_px: float
    nearest_min_px: float
    nearest_mean_px: float
    relative_radius: float
    """nearest_min over the distance in a hexagonal lattice of as many dots: Lagae & Dutré 2008,
    doi:10.1111/j.1467-8659.2007.01100.x; 0 for independent dots, up to about 0.78 for dots with a minimum distance.
    """
    nearest_edges_px: NDArray[np.float64]
    """(B + 1,) edges of the histogram's bins."""
    nearest_share: NDArray[np.float64]
    """(B,) share of the dots whose nearest neighbour is in the bin; the sum is 1."""
    frequency_per_px: NDArray[np.float64]
    """(F,) centre of each ring, cycles per px."""
    power: NDArray[np.float64]
    """(F,) mean power on the ring, 1 for independent dots; NaN on rings without a frequency."""
    low_frequency_power: float
    """Mean power below 0.3 cycles per d_min; 1 for independent dots, near 0 without clusters and gaps."""
    peak_power: float
    peak_frequency_per_px: float


def measure_blue_noise(pattern: Pattern) -> BlueNoise:
    """Measure the uniformity of a pattern; NaN where a single dot leaves a value undefined."""
    d_min, points = float(pattern.settings.d_min_px or np.nan), pattern.dots[:, :2]
    nearest = _nearest_distances(points)
    edges = np.linspace(1, 2, 41) * d_min
    edges[-1] = max(
        edges[-1], nearest.max(initial=0) * (1 + 1e-9)
    )  # the last bin includes all larger distances
    share = np.histogram(nearest, edges)[0] / max(len(nearest), 1)
    power, low = _radial_power(points, pattern.size_px, d_min, pattern.keep_out())
    frequency = (FREQUENCIES[:-1] + FREQUENCIES[1:]) / 2 / d_min
    peak = int(np.nanargmax(power))
    lattice = np.sqrt(2 / np.sqrt(3) * pattern.size_px[0] * pattern.size_px[1] / max(len(points), 1))
    return BlueNoise(
        d_min_px=d_min,
        nearest_min_px=float(nearest.min(initial=np.inf)) if len(nearest) else np.nan,
        nearest_mean_px=float(nearest.mean()) if len(nearest) else np.nan,
        relative_radius=float(nearest.min() / lattice) if len(nearest) else np.nan,
        nearest_edges_px=edges,
        nearest_share=share,
        frequency_per_px=frequency,
        power=power,
        low_frequency_power=low,
        peak_power=float(power[peak]),
        peak_frequency_per_px=float(frequency[peak]),
    )


def _nearest_distances(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (N,) distances to the nearest other point; empty for fewer than two points."""
    from scipy.spatial import KDTree

    if len(points) < 2:
        return np.empty(0)
    return KDTree(points).query(points, k=2)[0][:, 1]


def _radial_power(
    points: NDArray[np.float64], size_px: tuple[int, int], d_min_px: float, keep_out: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Return the radially averaged |Σ exp(-2πi f·x)|²/N on the rings, and its mean below LOW_FREQUENCY.

    The mean density outside the keep-out discs is subtracted first, because these holes are intended and no clusters.
    """
    from scipy.fft import next_fast_len

    def cells(length_px: int) -> int:
        return next_fast_len(ceil(BINS_PER_D_MIN * length_px / d_min_px), real=True)

    width, height = size_px
    columns, rows = (cells(s) for s in size_px)
    column = np.clip(np.floor((points[:, 0] + 0.5) * columns / width).astype(np.int64), 0, columns - 1)
    row = np.clip(np.floor((points[:, 1] + 0.5) * rows / height).astype(np.int64), 0, rows - 1)
    dots = np.bincount(row * columns + column, minlength=rows * columns).reshape(rows, columns)
    is_open = _cells_outside((columns, rows), size_px, keep_out)
    spectrum = np.fft.rfft2(dots - is_open * (len(points) / is_open.sum()))
    across, along = np.arange(int(spectrum.shape[1])) / width, np.fft.fftfreq(rows, 1 / rows) / height
    radius = np.hypot(along[:, None], across) * d_min_px
    radius[0, 0] = np.inf  # the mean carries no information on clusters
    multiplicity = np.where(across > 0, 2.0, 1.0)  # the half plane of negative frequencies is symmetric
    power, weight = (
        np.abs(spectrum) ** 2 / len(points) * multiplicity,
        np.broadcast_to(multiplicity, radius.shape),
    )
    is_on_ring = radius < FREQUENCIES[-1]
    total = np.histogram(radius[is_on_ring], FREQUENCIES, weights=power[is_on_ring])[0]
    count = np.histogram(radius[is_on_ring], FREQUENCIES, weights=weight[is_on_ring])[0]
    is_low = radius < LOW_FREQUENCY
    with np.errstate(invalid="ignore"):
        return total / count, float(power[is_low].sum() / weight[is_low].sum()) if is_low.any() else np.nan


def _cells_outside(
    cells: tuple[int, int], size_px: tuple[int, int], discs: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return (rows, columns) 1 where the centre of a cell lies in no disc, else 0."""
    (columns, rows), (width, height) = cells, size_px
    x = (np.arange(columns) + 0.5) * width / columns - 0.5
    y = (np.arange(rows) + 0.5) * height / rows - 0.5
    is_outside = np.ones((rows, columns))
    for cx, cy, radius in discs:
        i, j = np.flatnonzero(np.abs(x - cx) < radius), np.flatnonzero(np.abs(y - cy) < radius)
        if i.size and j.size:
            window = is_outside[j[0] : j[-1] + 1, i[0] : i[-1] + 1]
            window[(x[i] - cx) ** 2 + ((y[j] - cy) ** 2)[:, None] < radius * radius] = 0
    return is_outside
