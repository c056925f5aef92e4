"""Distances from phases: standard deviation, unambiguous range, and the combination of several frequencies."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from math import gcd

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LIGHT_MM_S = 299_792_458_000.0
"""Speed of light (SI, exact)."""


def unambiguous_range_mm(frequency_hz: float) -> float:
    """Return the distance after which one frequency's phase repeats, c / 2f."""
    return LIGHT_MM_S / (2 * frequency_hz)


def common_range_mm(frequencies_hz: Sequence[float]) -> float:
    """Return the unambiguous range of all frequencies together: of their greatest common divisor, in whole kHz."""
    return unambiguous_range_mm(reduce(gcd, (round(f / 1000) for f in frequencies_hz)) * 1000)


def distance_sigma_mm(noise_e: Array, amplitude_e: Array, frequencies_hz: Sequence[float]) -> Array:
    """Return (n, H, W) σ of the distance at each frequency: c / 4πf · noise over amplitude (Lange & Seitz 2001).

    ``noise_e`` (H, W) is the noise of one component, ``amplitude_e`` (n, H, W) the amplitude of the phasor.
    """
    scale = LIGHT_MM_S / (4 * np.pi * np.asarray(frequencies_hz))
    return scale[:, None, None] * noise_e / amplitude_e


def combine_phases(phases: Array, sigma_mm: Array, frequencies_hz: Sequence[float]) -> tuple[Array, Array]:
    """Return the distance (H, W) and its σ from phases (n, H, W).

    Of all repetitions of the highest frequency within the common range, the one with which the other frequencies
    agree best is taken; the distance is then the mean weighted by 1/σ². With one frequency it lies within that
    frequency's range.
    """
    ranges = np.array([unambiguous_range_mm(f) for f in frequencies_hz])
    distances = np.mod(phases, 2 * np.pi) / (2 * np.pi) * ranges[:, None, None]
    base = int(np.argmin(ranges))
    best: Array = distances[base]
    best_cost: Array = np.full(distances.shape[1:], np.inf)
    for wrap in range(round(common_range_mm(frequencies_hz) / ranges[base])):
        candidate: Array = distances[base] + wrap * ranges[base]
        difference = _wrap(distances - candidate, ranges)
        cost: Array = (difference**2 / (sigma_mm**2 + sigma_mm[base] ** 2)).sum(axis=0)
        best, best_cost = np.where(cost < best_cost, candidate, best), np.minimum(cost, best_cost)
    weight = 1 / sigma_mm**2
    shift = (weight * _wrap(distances - best, ranges)).sum(axis=0) / weight.sum(axis=0)
    return best + shift, np.sqrt(1 / weight.sum(axis=0))


def _wrap(difference: Array, ranges: Array) -> Array:
    """Return differences (n, H, W) wrapped to within half a period of zero."""
    period = ranges[:, None, None]
    return difference - np.round(difference / period) * period
