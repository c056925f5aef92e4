"""Lens models: the distortion of image-plane coordinates as one sum of terms, with its derivatives.

    x' = x f(r²) + 2 p1 x y + p2 (r² + 2 x²) + s1 r² + s2 r⁴
    y' = y f(r²) + p1 (r² + 2 y²) + 2 p2 x y + s3 r² + s4 r⁴,

with the radial factor f of `radial`, Brown's tangential terms p1, p2, the thin prism's s1 to s4 and, after them, the
homography of a tilted sensor (`tilt`). Each model has some of these terms. Brown's model computes what it has always
computed, operation by operation: rigs keep their results to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.lens import tilt
from beltscape.core.geometry.lens.radial import RadialFactor

Array: TypeAlias = NDArray[np.float64]


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
