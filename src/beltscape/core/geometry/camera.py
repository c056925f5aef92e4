"""A camera's intrinsics: the pinhole model with OpenCV's five distortion coefficients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry import lens


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """Pinhole camera with lens distortion; pixel (0, 0) is the centre of the top-left pixel."""

    name: str
    size_px: tuple[int, int]
    """(width, height)."""
    focal_px: NDArray[np.float64]
    """(2,) fx, fy."""
    center_px: NDArray[np.float64]
    """(2,) cx, cy, the principal point."""
    distortion: NDArray[np.float64]
    """(5,) k1, k2, p1, p2, k3 in OpenCV's order and model."""

    @property
    def matrix(self) -> NDArray[np.float64]:
        """The intrinsic matrix K (3, 3)."""
        (fx, fy), (cx, cy) = self.focal_px, self.center_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def project(self, points_mm: NDArray[np.floating]) -> NDArray[np.float64]:
        """Project points (..., 3) in the camera's frame, mm, to distorted pixels (..., 2); NaN behind the camera."""
        points = np.asarray(points_mm, dtype=np.float64)
        depth = np.where(points[..., 2:] > 0, points[..., 2:], np.nan)
        return self.distort(points[..., :2] / depth) * self.focal_px + self.center_px

    def distort(self, ideal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distort undistorted image-plane coordinates x/z, y/z (..., 2)."""
        return np.stack(lens.distort(ideal[..., 0], ideal[..., 1], self.distortion), axis=-1)

    def undistort(self, pixels: NDArray[np.floating | np.integer]) -> NDArray[np.float64]:
        """Return undistorted image-plane coordinates x/z, y/z (..., 2) of distorted pixels (..., 2).

        Newton's method on the distortion, to machine precision; NaN for pixels that the lens model cannot produce.
        """
        distorted = (np.asarray(pixels, dtype=np.float64) - self.center_px) / self.focal_px
        ideal = distorted
        with np.errstate(all="ignore"):  # pixels beyond the model's range diverge and end as NaN
            for _ in range(20):
                xx, xy, yy = lens.differentiate(ideal[..., 0], ideal[..., 1], self.distortion)
                dx, dy = np.moveaxis(distorted - self.distort(ideal), -1, 0)
                step = np.stack([yy * dx - xy * dy, xx * dy - xy * dx], axis=-1)
                step /= (xx * yy - xy * xy)[..., None]
                ideal = ideal + step
                if not (np.abs(step) > 1e-15).any():
                    break
            xx, xy, yy = lens.differentiate(ideal[..., 0], ideal[..., 1], self.distortion)
            error = np.abs(self.distort(ideal) - distorted).max(axis=-1)
            is_valid = (error < 1e-9) & (xx * yy > xy * xy) & (xx + yy > 0)
        return np.where(is_valid[..., None], ideal, np.nan)

    def rays(self, part: slice = slice(None)) -> NDArray[np.float64]:
        """Return x/z, y/z (H, W, 2) of the pixels of the *undistorted* pinhole grid; ``part`` thins both axes."""
        width, height = self.size_px
        u = (np.arange(width, dtype=np.float64)[part] - float(self.center_px[0])) / float(self.focal_px[0])
        v = (np.arange(height, dtype=np.float64)[part] - float(self.center_px[1])) / float(self.focal_px[1])
        return np.stack(np.meshgrid(u, v), axis=-1)
