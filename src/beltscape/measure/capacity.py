"""How much a belt can carry on each millimetre, and how the load lies on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.belt_model import Belt

_STEP_MM = 0.5


def full_area_mm2(belt: Belt, surcharge_rad: float) -> float:
    """Cross-section of the fully loaded belt, by DIN 22101:2011-12, section 5, on the belt's own shape.

    The load fills the belt's usable width and rises from both its ends at the surcharge angle to a ridge in the
    middle (A = A1 + A2 there, with A1 = w²·tan β / 4 over the chord w). Of a belt of width B along its surface

        b = 0.9·B - 50 mm for B ≤ 2 m, b = B - 250 mm for wider ones

    is usable, the same from both ends. The width reaches from end to end as far as these were seen, else as far
    as the belt was: then the capacity is that of the part seen, and less than the belt's.

    DIN's three straight rolls are replaced by the cross-section as it was learned.
    """
    left, right = _ends(belt)
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
    return float(np.trapezoid(chord + ridge - belt.height_mm(inside), inside))


def belt_middle_mm(belt: Belt) -> tuple[float, float]:
    """Middle of the belt in x, and its σ: of its ends where both were seen, else of the trough, to a node's width."""
    edges = belt.edges
    if edges is not None and np.isfinite(edges.left_mm) and np.isfinite(edges.right_mm):
        sigma = 0.5 * float(np.hypot(edges.left_sigma_mm, edges.right_sigma_mm))
        return 0.5 * (edges.left_mm + edges.right_mm), sigma
    return belt.middle_mm, float(np.median(np.diff(belt.x_mm)))


def centre_mm(
    weight_mm2: NDArray[np.float64], load_mm: NDArray[np.float64], place_mm: NDArray[np.float64]
) -> float:
    """Mean of a place over the load's volume, cell by cell (Ny, Nx) each."""
    part = weight_mm2 * load_mm
    return float(np.sum(part * place_mm) / np.sum(part))


def _ends(belt: Belt) -> tuple[float, float]:
    """Ends of the belt in x, as far as they were seen."""
    left, right = belt.across_mm
    if belt.edges is not None:
        left = belt.edges.left_mm if np.isfinite(belt.edges.left_mm) else left
        right = belt.edges.right_mm if np.isfinite(belt.edges.right_mm) else right
    return left, right
