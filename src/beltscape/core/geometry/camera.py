"""A camera's intrinsics: the pinhole model with the distortion of a named lens model, and its domain of validity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.arrays import Array
from beltscape.core.checks import is_list_or_tuple, require_array, require_number, require_text, show_value
from beltscape.core.errors import ArgumentError
from beltscape.core.geometry import lens_domain, tilt
from beltscape.core.geometry.lens import MODELS, LensModel


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """Pinhole camera with lens distortion; pixel (0, 0) is the centre of the top-left pixel."""

    name: str
    size_px: tuple[int, int]
    """(width, height)."""
    focal_px: Array
    """(2,) fx, fy."""
    center_px: Array
    """(2,) cx, cy, the principal point."""
    distortion: Array
    """(n,) coefficients of the lens model in OpenCV's order; of ``brown`` (5,) k1, k2, p1, p2, k3."""
    model: str = "brown"
    """Name of the lens model, a key of `lens.MODELS`."""
    valid_radius_px: float | None = None
    """Distance from the principal point up to which the calibration holds, px of the image; None: no limit."""

    def __post_init__(self) -> None:
        """Raise ArgumentError unless size and parameters are those of a camera and a lens model."""
        require_text(self.name, "name")
        _require_size(self.size_px)
        for name in ("focal_px", "center_px"):
            require_array(getattr(self, name), name, (2,))
        require_array(self.distortion, "distortion", (None,))
        if self.valid_radius_px is not None:
            require_number(self.valid_radius_px, "valid_radius_px", 0.0)
        if not isinstance(self.model, str) or self.model not in MODELS:
            raise ArgumentError(
                f"lens model {show_value(self.model)} is unknown; the models are {', '.join(MODELS)}"
            )
        if len(self.distortion) != len(self.lens.coefficients):
            raise ArgumentError(
                f"lens model {self.model} has {len(self.lens.coefficients)} coefficients "
                f"({', '.join(self.lens.coefficients)}), {len(self.distortion)} were given"
            )

    @property
    def lens(self) -> LensModel:
        """The lens model."""
        return MODELS[self.model]

    @property
    def matrix(self) -> Array:
        """The intrinsic matrix K (3, 3)."""
        (fx, fy), (cx, cy) = self.focal_px, self.center_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def valid_radius(self) -> float:
        """Radius of the domain of validity in undistorted image-plane coordinates, tan θ off the axis; ∞: no limit.

        The lens model is one to one within it, and the calibration holds (`valid_radius_px`). Directions beyond it
        have no pixel, and their pixels no direction.
        """
        turning = lens_domain.find_valid_radius(self.model, self.distortion)
        if self.valid_radius_px is None:
            return turning
        image_radius = self.valid_radius_px / float(self.focal_px.mean())
        return lens_domain.find_radius_of_image_radius(self.model, self.distortion, image_radius)

    def project(self, points_mm: NDArray[np.floating]) -> Array:
        """Project points (..., 3) in the camera's frame, mm, to distorted pixels (..., 2).

        NaN behind the camera and beyond the domain of validity.
        """
        points = np.asarray(points_mm, dtype=np.float64)
        return np.stack(self.project_axes(points[..., 0], points[..., 1], points[..., 2]), axis=-1)

    def project_axes(self, x_mm: Array, y_mm: Array, z_mm: Array) -> tuple[Array, Array]:
        """Return what `project` returns of points with these coordinates as two arrays: columns and rows."""
        depth = np.where(z_mm > 0, z_mm, np.nan)
        u, v = self.distort_axes(x_mm / depth, y_mm / depth)
        (along, down), (column, row) = self.focal_px, self.center_px
        return u * along + column, v * down + row

    def distort(self, ideal: Array) -> Array:
        """Distort undistorted image-plane coordinates x/z, y/z (..., 2); NaN beyond the domain of validity."""
        return np.stack(self.distort_axes(ideal[..., 0], ideal[..., 1]), axis=-1)

    def distort_axes(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the distorted x/z and y/z of undistorted ones as two arrays, which is faster than pairs."""
        u, v = self.lens.distort(x, y, self.distortion)
        if self.valid_radius == np.inf:
            return u, v
        is_valid = x**2 + y**2 <= self.valid_radius**2
        return np.where(is_valid, u, np.nan), np.where(is_valid, v, np.nan)

    def undistort(self, pixels: NDArray[np.floating | np.integer]) -> Array:
        """Return undistorted image-plane coordinates x/z, y/z (..., 2) of distorted pixels (..., 2).

        Newton's method on the distortion, to machine precision; NaN for pixels beyond the domain of validity.
        """
        distorted = (np.asarray(pixels, dtype=np.float64) - self.center_px) / self.focal_px
        ideal = self._estimate_undistorted(distorted)
        (x, y), (u, v) = (np.ascontiguousarray(np.moveaxis(pairs, -1, 0)) for pairs in (ideal, distorted))
        lens, coefficients = self.lens, self.distortion
        with np.errstate(all="ignore"):  # pixels beyond the model's range diverge and end as NaN
            for _ in range(20):
                xx, xy, yx, yy = lens.differentiate(x, y, coefficients)
                at_u, at_v = lens.distort(x, y, coefficients)
                du, dv, determinant = u - at_u, v - at_v, xx * yy - xy * yx
                step_x, step_y = (yy * du - xy * dv) / determinant, (xx * dv - yx * du) / determinant
                x, y = x + step_x, y + step_y
                if not (np.fmax(np.abs(step_x), np.abs(step_y)) > 1e-15).any():
                    break
            xx, xy, yx, yy = lens.differentiate(x, y, coefficients)
            at_u, at_v = lens.distort(x, y, coefficients)
            error = np.maximum(np.abs(at_u - u), np.abs(at_v - v))
            is_valid = (error < 1e-9) & (xx * yy > xy * yx) & (xx + yy > 0)
            is_valid &= x**2 + y**2 <= self.valid_radius**2
        return np.stack([np.where(is_valid, x, np.nan), np.where(is_valid, y, np.nan)], axis=-1)

    def rays(self, part: slice = slice(None)) -> Array:
        """Return x/z, y/z (H, W, 2) of the pixels of the *undistorted* pinhole grid; ``part`` thins both axes."""
        width, height = self.size_px
        u = (np.arange(width, dtype=np.float64)[part] - float(self.center_px[0])) / float(self.focal_px[0])
        v = (np.arange(height, dtype=np.float64)[part] - float(self.center_px[1])) / float(self.focal_px[1])
        return np.stack(np.meshgrid(u, v), axis=-1)

    def _estimate_undistorted(self, distorted: Array) -> Array:
        """Return the start of `undistort`: the coordinates themselves, or the inverse of a strong radial factor."""
        if self.model == "brown":
            return distorted
        if self.lens.has_tilt:
            tau_x, tau_y = self.distortion[12:]
            distorted = np.stack(tilt.untilt(distorted[..., 0], distorted[..., 1], tau_x, tau_y), axis=-1)
        radius = np.sqrt((distorted**2).sum(axis=-1))
        undistorted: Array = np.asarray(
            np.interp(radius, *lens_domain.tabulate_inverse(self.model, self.distortion)), np.float64
        )
        return distorted * np.where(radius > 1e-12, undistorted / np.maximum(radius, 1e-12), 1.0)[..., None]


def _require_size(size_px: Any) -> None:
    is_size = is_list_or_tuple(size_px) and len(size_px) == 2
    if not is_size or not all(isinstance(side, int | np.integer) and side > 0 for side in size_px):
        raise ArgumentError(
            f"size_px = {show_value(size_px)}: must be (width, height), whole numbers above 0"
        )
