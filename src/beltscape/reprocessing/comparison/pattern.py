"""The pattern of a difference: in proportion to the load, or the same cross-section all along the belt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from beltscape.reprocessing.comparison.ledger import Numbers
from beltscape.reprocessing.comparison.uncertainty import PairedSums

_LEAST = 8
"""Intervals that are needed to tell two patterns apart. Chosen."""
_EVIDENCE = 9.0
"""χ² by which a pattern must be better than none, and than the other one: 3 σ."""


@dataclass(frozen=True, slots=True)
class Pattern:
    """A pattern that the differences of the intervals have in common."""

    kind: Literal["proportional", "constant"]
    value: float
    """Difference over the mean volume of both, or a cross-section in mm²."""
    sigma: float
    """One standard deviation of it, by the strips' own errors."""


def find_pattern(volume: PairedSums) -> Pattern | None:
    """Return the pattern that explains the differences of the intervals; None if none does, or both do.

    Each pattern is fitted by weighted least squares. Errors that all strips share are left out of the weights: they
    change the fitted value and not whether the differences follow the pattern.
    """
    used = (volume.length_mm > 0) & (volume.own_apart > 0) & np.isfinite(volume.own_apart)
    if np.count_nonzero(used) < _LEAST:
        return None
    difference, weight = volume.difference[used], 1 / volume.own_apart[used]
    none = float((weight * difference**2).sum())
    fits = [
        _fit("proportional", volume.value.mean(axis=0)[used], difference, weight),
        _fit("constant", volume.length_mm[used], difference, weight),
    ]
    (best, least), (_, second) = sorted(fits, key=lambda fit: fit[1])
    freedom = len(difference) - 1
    follows = least <= freedom + 3 * np.sqrt(2 * freedom)  # mean and three standard deviations of χ²
    return best if follows and none - least > _EVIDENCE and second - least > _EVIDENCE else None


def _fit(
    kind: Literal["proportional", "constant"], quantity: Numbers, difference: Numbers, weight: Numbers
) -> tuple[Pattern, float]:
    """Return the pattern of differences in proportion to a quantity, and the χ² that it leaves."""
    norm = float((weight * quantity**2).sum())
    if norm <= 0:
        return Pattern(kind, 0.0, np.inf), np.inf
    value = float((weight * quantity * difference).sum()) / norm
    return Pattern(kind, value, norm**-0.5), float((weight * (difference - value * quantity) ** 2).sum())
