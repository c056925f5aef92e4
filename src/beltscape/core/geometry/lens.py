"""Lens models by name: Brown's polynomial, OpenCV's rational, thin-prism and tilted models, and the fisheye model.

The distortion of image-plane coordinates is one sum of terms, which `LensModel` gives with its derivatives:

    x' = x f(r²) + 2 p1 x y + p2 (r² + 2 x²) + s1 r² + s2 r⁴
    y' = y f(r²) + p1 (r² + 2 y²) + 2 p2 x y + s3 r² + s4 r⁴,

with r² = x² + y² of undistorted image-plane coordinates x/z, y/z, the radial factor f, Brown's tangential terms p1,
p2, the thin prism's s1 to s4 and, after them, the homography of a tilted sensor (`tilt`). Each model has some of
these terms. Brown's model computes what it has always computed, operation by operation: rigs keep their results to
the last bit. The distorted radius r f(r²) rises from 0 up to the turning point; beyond it a second direction would
have the same pixel, so no model is used there.

`lens_domain` gives the radius up to which a model is valid. Every Python module that needs a lens calls these;
`native/lens.hpp` holds them once more for the kernels.

References
----------
D. C. Brown, Close-range camera calibration, Photogrammetric Engineering 37(8), 855-866, 1971.
J. Kannala, S. S. Brandt, A generic camera model and calibration method for conventional, wide-angle, and fish-eye
lenses, IEEE TPAMI 28(8), 2006, doi:10.1109/TPAMI.2006.153.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.polynomial import polynomial

from beltscape.core.arrays import Array, Floats
from beltscape.core.geometry import tilt

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


def _find_first_root(ascending: Floats | list[float]) -> float:
    """Return the least positive real root of a polynomial with ascending coefficients, the first 1; ∞ without any.

    The roots' reciprocals are those of a polynomial with leading coefficient 1, whatever the others are.
    """
    reciprocals = polynomial.polyroots(np.asarray(ascending, np.float64)[::-1])
    is_root = (np.abs(reciprocals.imag) < 1e-9 * np.abs(reciprocals)) & (reciprocals.real > 1e-12)
    return 1 / float(reciprocals.real[is_root].max()) if is_root.any() else float("inf")


@dataclass(frozen=True, slots=True)
class LensModel:
    """A lens model by its terms.

    ``x`` and ``y`` are x/z and y/z of any shape; ``coefficients`` are (n,), or (n, N) of each of N points, in the
    order of `coefficients`.
    """

    name: str
    coefficients: tuple[str, ...]
    """Names of the n coefficients, in their order in `rig.json` and in OpenCV."""
    radial: RadialFactor

    @property
    def has_tangential(self) -> bool:
        """True if the model has p1 and p2, which are then its third and fourth coefficient."""
        return "p1" in self.coefficients

    @property
    def has_prism(self) -> bool:
        """True if the model has s1 to s4, which are then its ninth to twelfth coefficient."""
        return "s1" in self.coefficients

    @property
    def has_tilt(self) -> bool:
        """True if the model has tau_x and tau_y, which are then its last coefficients."""
        return "tau_x" in self.coefficients

    def distort(self, x: Array, y: Array, coefficients: Array) -> tuple[Array, Array]:
        """Return the distorted coordinates of undistorted image-plane coordinates."""
        x, y = self._distort_untilted(x, y, coefficients)
        return tilt.tilt(x, y, coefficients[12], coefficients[13]) if self.has_tilt else (x, y)

    def differentiate(self, x: Array, y: Array, coefficients: Array) -> tuple[Array, Array, Array, Array]:
        """Return the derivatives ∂x'/∂x, ∂x'/∂y, ∂y'/∂x and ∂y'/∂y of `distort`."""
        xx, xy, yx, yy = self._differentiate_untilted(x, y, coefficients)
        if not self.has_tilt:
            return xx, xy, yx, yy
        u, v = self._distort_untilted(x, y, coefficients)
        a, b, c, d = tilt.differentiate(u, v, coefficients[12], coefficients[13])
        return a * xx + b * yx, a * xy + b * yy, c * xx + d * yx, c * xy + d * yy

    def differentiate_by_coefficients(
        self, x: Array, y: Array, coefficients: Array, focal_x: Array, focal_y: Array
    ) -> Array:
        """Return the derivatives (n, 2, ...) of a pixel (focal_x · x', focal_y · y') by the coefficients."""
        if self.has_tilt:
            return self._differentiate_tilted_by_coefficients(x, y, coefficients, focal_x, focal_y)
        return np.array(self._list_derivatives(x, y, coefficients, focal_x, focal_y))

    def _distort_untilted(self, x: Array, y: Array, coefficients: Array) -> tuple[Array, Array]:
        xx, xy, yy = x * x, x * y, y * y
        r2 = xx + yy
        radial = self.radial.compute(r2, coefficients)
        if not self.has_tangential:
            return x * radial, y * radial
        p1, p2 = coefficients[2], coefficients[3]
        u = x * radial + p1 * (2 * xy) + p2 * (r2 + 2 * xx)
        v = y * radial + p1 * (r2 + 2 * yy) + p2 * (2 * xy)
        if not self.has_prism:
            return u, v
        s1, s2, s3, s4 = coefficients[8:12]
        return u + r2 * (s1 + r2 * s2), v + r2 * (s3 + r2 * s4)

    def _differentiate_untilted(
        self, x: Array, y: Array, coefficients: Array
    ) -> tuple[Array, Array, Array, Array]:
        xx, xy, yy = x * x, x * y, y * y
        r2 = xx + yy
        radial, slope = self.radial.compute(r2, coefficients), self.radial.compute_slope(r2, coefficients)
        if not self.has_tangential:
            across = slope * xy
            return radial + slope * xx, across, across, radial + slope * yy
        p1, p2 = coefficients[2], coefficients[3]
        across = slope * xy + 2 * (p1 * x + p2 * y)
        by_x, by_y = (
            radial + slope * xx + 2 * p1 * y + 6 * p2 * x,
            radial + slope * yy + 6 * p1 * y + 2 * p2 * x,
        )
        if not self.has_prism:
            return by_x, across, across, by_y
        s1, s2, s3, s4 = coefficients[8:12]
        first, second = 2 * (s1 + 2 * r2 * s2), 2 * (s3 + 2 * r2 * s4)
        return by_x + first * x, across + first * y, across + second * x, by_y + second * y

    def _list_derivatives(
        self, x: Array, y: Array, coefficients: Array, focal_x: Array, focal_y: Array
    ) -> list[Array]:
        """Return the derivatives (2, ...) of the pixel without tilt by each coefficient but the tilt's."""
        xx, xy, yy = x * x, x * y, y * y
        r2 = xx + yy
        base = np.array([focal_x * x, focal_y * y])
        radial = self.radial.differentiate_by_coefficients(base, r2, coefficients)
        if not self.has_tangential:
            return radial
        by_p1 = np.array([focal_x * (2 * xy), focal_y * (r2 + 2 * yy)])
        by_p2 = np.array([focal_x * (r2 + 2 * xx), focal_y * (2 * xy)])
        rows = [*radial[:2], by_p1, by_p2, *radial[2:]]
        if not self.has_prism:
            return rows
        along_x, along_y, none = focal_x * r2, focal_y * r2, np.zeros_like(r2)
        prism = (along_x, none), (along_x * r2, none), (none, along_y), (none, along_y * r2)
        return [*rows, *(np.array(pair) for pair in prism)]

    def _differentiate_tilted_by_coefficients(
        self, x: Array, y: Array, coefficients: Array, focal_x: Array, focal_y: Array
    ) -> Array:
        u, v = self._distort_untilted(x, y, coefficients)
        tau_x, tau_y = coefficients[12], coefficients[13]
        a, b, c, d = tilt.differentiate(u, v, tau_x, tau_y)
        one = np.ones_like(x)
        untilted = np.array(self._list_derivatives(x, y, coefficients, one, one))
        by_x, by_y = untilted[:, 0], untilted[:, 1]
        rows = np.empty((len(self.coefficients), 2, *x.shape))
        rows[:12] = np.stack([focal_x * (a * by_x + b * by_y), focal_y * (c * by_x + d * by_y)], axis=1)
        angles = tilt.differentiate_by_angles(u, v, tau_x, tau_y)
        rows[12], rows[13] = (
            (focal_x * angles[0], focal_y * angles[1]),
            (focal_x * angles[2], focal_y * angles[3]),
        )
        return rows


_BROWN = ("k1", "k2", "p1", "p2", "k3")
_RATIONAL = (*_BROWN, "k4", "k5", "k6")
_PRISM = (*_RATIONAL, "s1", "s2", "s3", "s4")

BROWN = LensModel("brown", _BROWN, Polynomial())
RATIONAL = LensModel("rational", _RATIONAL, Rational())
THIN_PRISM = LensModel("thin_prism", _PRISM, Rational())
TILTED = LensModel("tilted", (*_PRISM, "tau_x", "tau_y"), Rational())
FISHEYE = LensModel("fisheye", ("k1", "k2", "k3", "k4"), Fisheye())

MODELS: Mapping[str, LensModel] = MappingProxyType(
    {model.name: model for model in (BROWN, RATIONAL, THIN_PRISM, TILTED, FISHEYE)}
)
"""All lens models by name, from few to many coefficients, the fisheye last."""


def list_intrinsics(model: str) -> tuple[str, ...]:
    """Return the names, with units, of the intrinsics of a camera with a lens model, as in rig.json's covariance."""
    coefficients = (f"{name}_rad" if name[0] == "t" else name for name in MODELS[model].coefficients)
    return ("fx_px", "fy_px", "cx_px", "cy_px", *coefficients)
