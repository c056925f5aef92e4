"""Sizes by mass: what passes which sieve, and the sizes that so much of the mass is smaller than."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SHARES = (0.1, 0.5, 0.8, 0.9)
"""Of d10, d50, d80, d90."""
_RESAMPLES = 300


@dataclass(frozen=True, slots=True, eq=False)
class SizeDistribution:
    """Of lumps by estimated mass (all of one density)."""

    count: int
    """How many lumps it is from."""
    d_mm: tuple[float, float, float, float]
    """d10, d50, d80, d90; NaN without lumps."""
    d_sigma_mm: tuple[float, float, float, float]
    """One standard deviation each, for so few lumps were seen (bootstrap, Efron 1979, 10.1214/aos/1176344552); the
    top layer's bias is not in it."""
    sieves_mm: NDArray[np.float64]
    """(K,) apertures."""
    passing: NDArray[np.float64]
    """(K,) share of the mass that passes, 0..1; NaN without lumps."""


def distribution(
    size_mm: NDArray[np.float64], mass: NDArray[np.float64], sieves_mm: NDArray[np.float64]
) -> SizeDistribution:
    """From sizes (N,) mm and masses (N,) in any unit, each lump weighted as it stands for others."""
    if not len(size_mm):
        nothing = (np.nan, np.nan, np.nan, np.nan)
        return SizeDistribution(0, nothing, nothing, sieves_mm, np.full(len(sieves_mm), np.nan))
    rng = np.random.default_rng(0)
    drawn = []
    for _ in range(_RESAMPLES):
        pick = rng.integers(0, len(size_mm), len(size_mm))
        drawn.append(passing_size(size_mm[pick], mass[pick], SHARES))
    found = passing_size(size_mm, mass, SHARES)
    spread = np.std(drawn, axis=0)
    return SizeDistribution(
        len(size_mm), _four(found), _four(spread), sieves_mm, passing_share(size_mm, mass, sieves_mm)
    )


def _four(values: NDArray[np.float64]) -> tuple[float, float, float, float]:
    return (float(values[0]), float(values[1]), float(values[2]), float(values[3]))


def passing_size(
    size_mm: NDArray[np.float64], mass: NDArray[np.float64], shares: tuple[float, ...]
) -> NDArray[np.float64]:
    """Sizes that these shares of the mass are smaller than; between lumps linearly, half of each below its size."""
    order = np.argsort(size_mm, kind="stable")
    size, part = size_mm[order], mass[order] / mass.sum()
    return np.interp(shares, np.cumsum(part) - part / 2, size)


def passing_share(
    size_mm: NDArray[np.float64], mass: NDArray[np.float64], sieves_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(K,) share of the mass in lumps no larger than each aperture (K,)."""
    small = size_mm[None] <= sieves_mm[:, None]
    return (small * mass).sum(axis=1) / mass.sum()
