"""Radial factors f(r²) of the lens models, with derivatives and turning point: x' = x f and y' = y f.

r² = x² + y² of undistorted image-plane coordinates x/z, y/z. The distorted radius r f(r²) rises from 0 up to the
turning point; beyond it a second direction would have the same pixel, so no model is used there.

References
----------
D. C. Brown, Close-range camera calibration, Photogrammetric Engineering 37(8), 855-866, 1971.
J. Kannala, S. S. Brandt, A generic camera model and calibration method for conventional, wide-angle, and fish-eye
lenses, IEEE TPAMI 28(8), 2006, doi:10.1109/TPAMI.2006.153.
"""

from __future__ import annotations

from typing import Protocol, TypeAlias

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

_SERIES_BELOW = 1e-2
"""r² below which the series of atan(r)/r replaces the quotient: its ninth term is then below 1e-17."""
_SERIES = np.array([(-1.0) ** n / (2 * n + 1) for n in range(9)])
_SERIES_SLOPE = polynomial.polyder(_SERIES)


class RadialFactor(Protocol):
    """A radial factor; ``coefficients`` are all of its model's, (n,) or (n, N) of N points."""

    def compute(self, r2: Array, coefficients: Array) -> Array:
        """Return f(r²)."""
        ...

    def compute_slope(self, r2: Array, coefficients: Array) -> Array:
        """Return 2 ∂f/∂r², which times x is ∂f/∂x."""
        ...

    def differentiate_by_coefficients(self, base: Array, r2: Array, coefficients: Array) -> list[Array]:
        """Return ``base`` · ∂f/∂k for every radial coefficient k, in the model's order."""
        ...

    def find_turning_point(self, coefficients: Array) -> float:
        """Return the first r > 0 where r f(r²) stops rising, ∞ if it rises for all; ``coefficients`` are (n,)."""
        ...


class Polynomial:
    """f = 1 + k1 r² + k2 r⁴ + k3 r⁶, of coefficients k1, k2, p1, p2, k3."""

    def compute(self, r2: Array, coefficients: Array) -> Array:
        """Return f(r²)."""
        k1, k2, k3 = coefficients[0], coefficients[1], coefficients[4]
        return 1 + r2 * (k1 + r2 * (k2 + r2 * k3))

    def compute_slope(self, r2: Array, coefficients: Array) -> Array:
        """Return 2 ∂f/∂r²."""
        k1, k2, k3 = coefficients[0], coefficients[1], coefficients[4]
        return 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))

    def differentiate_by_coefficients(self, base: Array, r2: Array, coefficients: Array) -> list[Array]:
        """Return ``base`` · ∂f/∂k of k1, k2, k3."""
        del coefficients  # f is linear in them
        radial = base * r2
        return [radial, radial * r2, radial * r2 * r2]

    def find_turning_point(self, coefficients: Array) -> float:
        """Return the first r > 0 where r f(r²) stops rising."""
        k1, k2, k3 = coefficients[0], coefficients[1], coefficients[4]
        return float(np.sqrt(_find_first_root([1.0, 3 * k1, 5 * k2, 7 * k3])))


class Rational:
    """f = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶), of k1, k2, p1, p2, k3, k4, k5, k6, …."""

    def compute(self, r2: Array, coefficients: Array) -> Array:
        """Return f(r²)."""
        numerator, denominator = self._evaluate(r2, coefficients)
        return numerator / denominator

    def compute_slope(self, r2: Array, coefficients: Array) -> Array:
        """Return 2 ∂f/∂r²."""
        k1, k2, _, _, k3, k4, k5, k6 = coefficients[:8]
        numerator, denominator = self._evaluate(r2, coefficients)
        above = k1 + r2 * (2 * k2 + 3 * r2 * k3)
        below = k4 + r2 * (2 * k5 + 3 * r2 * k6)
        return 2 * (above - below * numerator / denominator) / denominator

    def differentiate_by_coefficients(self, base: Array, r2: Array, coefficients: Array) -> list[Array]:
        """Return ``base`` · ∂f/∂k of k1, k2, k3, k4, k5, k6."""
        numerator, denominator = self._evaluate(r2, coefficients)
        above = base * r2 / denominator
        below = -above * numerator / denominator
        return [above, above * r2, above * r2 * r2, below, below * r2, below * r2 * r2]

    def find_turning_point(self, coefficients: Array) -> float:
        """Return the first r > 0 where r f(r²) stops rising, or where its denominator vanishes."""
        k1, k2, _, _, k3, k4, k5, k6 = coefficients[:8]
        above, below = np.array([1.0, k1, k2, k3]), np.array([1.0, k4, k5, k6])
        wronskian = polynomial.polysub(
            polynomial.polymul(polynomial.polyder(above), below),
            polynomial.polymul(above, polynomial.polyder(below)),
        )
        slope = polynomial.polyadd(polynomial.polymul(above, below), polynomial.polymulx(2 * wronskian))
        return float(np.sqrt(min(_find_first_root(slope), _find_first_root(below))))

    def _evaluate(self, r2: Array, coefficients: Array) -> tuple[Array, Array]:
        k1, k2, _, _, k3, k4, k5, k6 = coefficients[:8]
        return 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), 1 + r2 * (k4 + r2 * (k5 + r2 * k6))


class Fisheye:
    """f = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸) / r with θ = atan r, of k1, k2, k3, k4."""

    def compute(self, r2: Array, coefficients: Array) -> Array:
        """Return f(r²)."""
        angle, _ = _angle_over_radius(r2)
        return angle * self._evaluate(r2 * angle * angle, coefficients)

    def compute_slope(self, r2: Array, coefficients: Array) -> Array:
        """Return 2 ∂f/∂r²."""
        k1, k2, k3, k4 = coefficients
        angle, slope = _angle_over_radius(r2)
        t = r2 * angle * angle  # θ²
        by_t = k1 + t * (2 * k2 + t * (3 * k3 + t * 4 * k4))
        t_slope = angle * (angle + 2 * r2 * slope)
        return 2 * (slope * self._evaluate(t, coefficients) + angle * by_t * t_slope)

    def differentiate_by_coefficients(self, base: Array, r2: Array, coefficients: Array) -> list[Array]:
        """Return ``base`` · ∂f/∂k of k1, k2, k3, k4."""
        del coefficients  # f is linear in them
        angle, _ = _angle_over_radius(r2)
        t = r2 * angle * angle
        first = base * angle * t
        return [first, first * t, first * t * t, first * t * t * t]

    def find_turning_point(self, coefficients: Array) -> float:
        """Return the first r > 0 where r f(r²) stops rising; ∞ if that is at 90° or more."""
        k1, k2, k3, k4 = coefficients
        angle = np.sqrt(_find_first_root([1.0, 3 * k1, 5 * k2, 7 * k3, 9 * k4]))
        return float(np.tan(angle)) if angle < np.pi / 2 else float("inf")

    def _evaluate(self, t: Array, coefficients: Array) -> Array:
        k1, k2, k3, k4 = coefficients
        return 1 + t * (k1 + t * (k2 + t * (k3 + t * k4)))


def _angle_over_radius(r2: Array) -> tuple[Array, Array]:
    """Return atan(r)/r and its derivative by r²."""
    is_small = r2 < _SERIES_BELOW
    safe = np.where(is_small, 1.0, r2)
    radius = np.sqrt(safe)
    quotient = np.arctan(radius) / radius
    slope = (1 / (1 + safe) - quotient) / (2 * safe)
    small = np.where(is_small, r2, 0.0)
    return (
        np.where(is_small, polynomial.polyval(small, _SERIES), quotient),
        np.where(is_small, polynomial.polyval(small, _SERIES_SLOPE), slope),
    )


def _find_first_root(ascending: Array | list[float]) -> float:
    """Return the least positive real root of a polynomial with ascending coefficients, the first 1; ∞ without any.

    The roots' reciprocals are those of a polynomial with leading coefficient 1, whatever the others are.
    """
    reciprocals = polynomial.polyroots(np.asarray(ascending, np.float64)[::-1])
    is_root = (np.abs(reciprocals.imag) < 1e-9 * np.abs(reciprocals)) & (reciprocals.real > 1e-12)
    return 1 / float(reciprocals.real[is_root].max()) if is_root.any() else float("inf")
