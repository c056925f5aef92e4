"""Particle size distribution by mass: passing shares of sieves, and the percentiles d10 to d90."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SHARES = (0.1, 0.5, 0.8, 0.9)
"""Mass shares of d10, d50, d80, d90."""
_RESAMPLES = 300
"""Bootstrap samples of the lumps: σ itself is then known to 4 %."""


@dataclass(frozen=True, slots=True, eq=False)
class SizeDistribution:
    """The size distribution of lumps by estimated mass, at uniform density."""

    count: int
    """Number of lumps."""
    d_mm: tuple[float, float, float, float]
    """d10, d50, d80, d90; NaN without lumps."""
    d_sigma_mm: tuple[float, float, float, float]
    """One standard deviation each, from the number of lumps (bootstrap, Efron 1979, 10.1214/aos/1176344552); the
    top layer's bias is not included."""
    sieves_mm: NDArray[np.float64]
    """(K,) apertures."""
    passing: NDArray[np.float64]
    """(K,) share of the mass that passes, 0..1; NaN without lumps."""


def compute_distribution(
    size_mm: NDArray[np.float64], mass: NDArray[np.float64], sieves_mm: NDArray[np.float64]
) -> SizeDistribution:
    """Compute the distribution of sizes (N,) mm weighted by masses (N,) in any unit."""
    if not len(size_mm):
        no_percentiles = (np.nan, np.nan, np.nan, np.nan)
        return SizeDistribution(0, no_percentiles, no_percentiles, sieves_mm, np.full(len(sieves_mm), np.nan))
    rng = np.random.default_rng(0)
    samples: list[NDArray[np.float64]] = []
    for _ in range(_RESAMPLES):
        indices = rng.integers(0, len(size_mm), len(size_mm))
        samples.append(compute_passing_sizes(size_mm[indices], mass[indices], SHARES))
    percentiles = compute_passing_sizes(size_mm, mass, SHARES)
    spread = np.std(samples, axis=0)
    return SizeDistribution(
        len(size_mm),
        _as_four_floats(percentiles),
        _as_four_floats(spread),
        sieves_mm,
        compute_passing_shares(size_mm, mass, sieves_mm),
    )


def _as_four_floats(values: NDArray[np.float64]) -> tuple[float, float, float, float]:
    return (float(values[0]), float(values[1]), float(values[2]), float(values[3]))


def compute_passing_sizes(
    size_mm: NDArray[np.float64], mass: NDArray[np.float64], shares: tuple[float, ...]
) -> NDArray[np.float64]:
    """Return the sizes below which these shares of the mass lie, interpolated; half of each lump counts below."""
    order = np.argsort(size_mm, kind="stable")
    size, part = size_mm[order], mass[order] / mass.sum()
    return np.interp(shares, np.cumsum(part) - part / 2, size)


def compute_passing_shares(
    size_mm: NDArray[np.float64], mass: NDArray[np.float64], sieves_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the share of the mass (K,) in lumps no larger than each aperture (K,)."""
    small = size_mm[None] <= sieves_mm[:, None]
    return (small * mass).sum(axis=1) / mass.sum()
