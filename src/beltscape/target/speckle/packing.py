"""Capacity of a plane for dart throwing: the number of dots before it is full."""

from __future__ import annotations

from collections.abc import Callable
from math import pi

SATURATED_SHARE = 0.5470735
"""Area share of discs of diameter d_min placed at random until none fits: Zhang & Torquato, Phys. Rev. E 88,
053312 (2013), doi:10.1103/PhysRevE.88.053312.
"""

MAX_SHARE = 0.97
"""Maximum share of the saturated number; filling the last gaps would take too long."""

AUTOMATIC_SHARE = 0.95
"""Share of the saturated number for an automatic d_min."""

BORDER_D_MIN = 0.45
"""Centres may lie on the border: the plane acts as if larger by this many d_min (measured); half at discs."""


def saturated_count(size_px: tuple[int, int], d_min_px: float, keep_out_px: float, discs: int) -> float:
    """Return the saturated number of dots in W × H px with ``discs`` keep-out discs; 0 where these fill the plane."""
    width, height = size_px
    radius = max(keep_out_px - BORDER_D_MIN * d_min_px / 2, 0)
    area = (width + BORDER_D_MIN * d_min_px) * (
        height + BORDER_D_MIN * d_min_px
    ) - discs * pi * radius * radius
    return max(area, 0) * SATURATED_SHARE / (pi / 4 * d_min_px * d_min_px)


def find_largest_d_min(saturated: Callable[[float], float], count: float) -> float:
    """Return the largest d_min, in steps of 0.01 px, for which ``saturated(d_min)`` is at least ``count``.

    ``saturated`` must not increase with d_min. 0.0 when 0.01 px is too large.
    """
    step, low, high = 0.01, 0, 1
    while saturated(high * step) >= count:
        high *= 2
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if saturated(middle * step) >= count else (low, middle)
    return round(low * step, 2)
