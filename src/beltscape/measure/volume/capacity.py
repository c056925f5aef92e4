"""The capacity of a belt (cross-section of its full load), its middle, and the load's centroid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.belt.empty_belt import Belt

_STEP_MM = 0.5
"""Step of the integration over the width."""


def compute_capacity_mm2(belt: Belt, surcharge_rad: float) -> float:
    """Return the cross-section of the fully loaded belt by DIN 22101:2011-12, section 5, on the measured shape.

    The load fills the belt's usable width and rises from both its ends at the surcharge angle to a ridge in the
    middle (A = A1 + A2 in the standard, with A1 = w²·tan β / 4 over the chord w). The usable width of a belt of
    width B along its surface, centred, is

        b = 0.9·B - 50 mm for B ≤ 2 m, b = B - 250 mm for wider belts.

    The width extends from edge to edge where both were found, else over the measured part: then the result is the
    capacity of that part, which is less than the belt's. The measured cross-section replaces DIN's straight idlers.
    It is 0 for a shape that holds no load, such as a narrow strip or a ridge.
    """
    left, right = _find_belt_ends(belt)
    x = np.linspace(left, right, max(3, int((right - left) / _STEP_MM)))
    z = belt.height_mm(x)
    run = np.r_[0.0, np.cumsum(np.hypot(np.diff(x), np.diff(z)))]
    width = float(run[-1])
    usable = 0.9 * width - 50.0 if width <= 2000.0 else width - 250.0
    if usable <= 0:
        return 0.0
    a, b = (float(np.interp(0.5 * (width + side * usable), run, x)) for side in (-1, 1))
    inside = np.linspace(a, b, max(3, int((b - a) / _STEP_MM)))
    low, high = belt.height_mm(np.array([a, b]))
    chord = low + (high - low) * (inside - a) / (b - a)
    ridge = np.minimum(inside - a, b - inside) * np.tan(surcharge_rad)
    return max(0.0, float(np.trapezoid(chord + ridge - belt.height_mm(inside), inside)))


def find_belt_middle(belt: Belt) -> tuple[float, float]:
    """Return the belt's middle in x and its σ: between its edges if both were found, else the trough's, to a node."""
    edges = belt.edges
    if edges is not None and np.isfinite(edges.left_mm) and np.isfinite(edges.right_mm):
        sigma = 0.5 * float(np.hypot(edges.left_sigma_mm, edges.right_sigma_mm))
        return 0.5 * (edges.left_mm + edges.right_mm), sigma
    return belt.middle_mm, float(np.median(np.diff(belt.x_mm)))


def compute_centroid_mm(
    weight_mm2: NDArray[np.float64], load_mm: NDArray[np.float64], position_mm: NDArray[np.float64]
) -> float:
    """Return the mean of a coordinate over the load's volume; all arguments (Ny, Nx)."""
    part = weight_mm2 * load_mm
    return float(np.sum(part * position_mm) / np.sum(part))


def _find_belt_ends(belt: Belt) -> tuple[float, float]:
    """Return the belt's edges in x where they were found, else the ends of the measured part."""
    left, right = belt.across_mm
    if belt.edges is not None:
        left = belt.edges.left_mm if np.isfinite(belt.edges.left_mm) else left
        right = belt.edges.right_mm if np.isfinite(belt.edges.right_mm) else right
    return left, right
