"""How many dots dart throwing can place before the plane is full."""

from __future__ import annotations

from collections.abc import Callable
from math import pi

SATURATED_SHARE = 0.5470735
"""Area share of discs of diameter d_min thrown at random until none fits: Zhang & Torquato, Phys. Rev. E 88, 053312
(2013), doi:10.1103/PhysRevE.88.053312."""

MAX_SHARE = 0.97
"""Share of the saturated number that is thrown without hunting for the last gaps; more is refused."""

AUTOMATIC_SHARE = 0.95
"""Share of the saturated number that an automatic d_min asks for."""

BORDER_D_MIN = 0.45
"""Centres may lie on the border, so the plane acts as if this many d_min larger; measured, as its half at discs."""


def saturated_count(size_px: tuple[int, int], d_min_px: float, keep_out_px: float, discs: int) -> float:
    """Saturated number of dots in W × H px with ``discs`` kept-out discs of that radius; 0 where these fill it."""
    width, height = size_px
    radius = max(keep_out_px - BORDER_D_MIN * d_min_px / 2, 0)
    area = (width + BORDER_D_MIN * d_min_px) * (
        height + BORDER_D_MIN * d_min_px
    ) - discs * pi * radius * radius
    return max(area, 0) * SATURATED_SHARE / (pi / 4 * d_min_px * d_min_px)


def find_largest_d_min(saturated: Callable[[float], float], count: float) -> float:
    """The largest d_min, in steps of 0.01 px, at which ``saturated(d_min)`` is still ``count``.

    ``saturated`` must not grow with d_min. 0.0 when even 0.01 px is too much.
    """
    step, low, high = 0.01, 0, 1
    while saturated(high * step) >= count:
        high *= 2
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if saturated(middle * step) >= count else (low, middle)
    return round(low * step, 2)
