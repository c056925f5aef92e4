"""Phases → distance: σ, repetition, several frequencies together."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from math import gcd

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LIGHT_MM_S = 299_792_458_000.0


def unambiguous_range_mm(frequency_hz: float) -> float:
    """Distance after which one frequency's phase repeats, c / 2f."""
    return LIGHT_MM_S / (2 * frequency_hz)


def common_range_mm(frequencies_hz: Sequence[float]) -> float:
    """Distance after which all frequencies together repeat: that of their greatest common divisor, in whole kHz."""
    return unambiguous_range_mm(reduce(gcd, (round(f / 1000) for f in frequencies_hz)) * 1000)


def distance_sigma_mm(noise_e: Array, amplitude_e: Array, frequencies_hz: Sequence[float]) -> Array:
    """(n, H, W) σ of the distance at each frequency: c / 4πf times noise over amplitude (Lange & Seitz 2001).

    ``noise_e`` (H, W) is one component's, ``amplitude_e`` (n, H, W) the phasor's.
    """
    scale = LIGHT_MM_S / (4 * np.pi * np.asarray(frequencies_hz))
    return scale[:, None, None] * noise_e / amplitude_e


def combine_phases(phases: Array, sigma_mm: Array, frequencies_hz: Sequence[float]) -> tuple[Array, Array]:
    """Distance (H, W) and its σ from phases (n, H, W).

    Of all repetitions of the highest frequency within the common range the one is taken that the other frequencies
    agree with best; then the mean, weighted by 1/σ². With one frequency the distance is within its own range.
    """
    ranges = np.array([unambiguous_range_mm(f) for f in frequencies_hz])
    own = np.mod(phases, 2 * np.pi) / (2 * np.pi) * ranges[:, None, None]
    base = int(np.argmin(ranges))
    best, best_cost = own[base], np.full(own.shape[1:], np.inf)
    for wrap in range(round(common_range_mm(frequencies_hz) / ranges[base])):
        candidate = own[base] + wrap * ranges[base]
        off = _wrap(own - candidate, ranges)
        cost = (off**2 / (sigma_mm**2 + sigma_mm[base] ** 2)).sum(axis=0)
        best, best_cost = np.where(cost < best_cost, candidate, best), np.minimum(cost, best_cost)
    weight = 1 / sigma_mm**2
    shift = (weight * _wrap(own - best, ranges)).sum(axis=0) / weight.sum(axis=0)
    return best + shift, np.sqrt(1 / weight.sum(axis=0))


def _wrap(difference: Array, ranges: Array) -> Array:
    """Differences (n, H, W) brought within half a repetition of zero."""
    period = ranges[:, None, None]
    return difference - np.round(difference / period) * period
