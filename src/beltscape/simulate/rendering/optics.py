"""A camera's lens: from pictures of ideal pinholes to the light on each pixel of the real camera.

Distortion is exact: every pixel has its own grid of sub-samples, each undistorted to its position in the pinholes'
fine pictures and weighted by the lens's blur and the pixel's area.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.geometry.camera import Camera
from beltscape.simulate.rendering.pinhole import Pinhole, make_pinholes

_NODE_PX = 8.0
"""Spacing of the nodes between which the distortion is interpolated."""
_BAND_ROWS = 128
"""Rows of pixels that are integrated at once, which bounds the memory."""


class Optics(BaseModel):
    """Properties of a lens besides its distortion."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    psf_sigma_px: Annotated[float, Field(ge=0, le=5)] = 0.6
    """Gaussian blur of the lens in focus; the pixel's area adds to it."""
    aperture_mm: Annotated[float, Field(ge=0, le=50)] = 0.0
    """Diameter of the entrance pupil (focal length over f-number); 0: everything is in focus."""
    focus_mm: Annotated[float, Field(gt=0, le=1e5)] = 750.0
    """Depth of the plane in focus; it matters only with an aperture."""
    falloff: Annotated[float, Field(ge=0, le=8)] = 0.0
    """Vignetting, as this power of the cosine of the field angle; 4 is a simple lens."""


class Lens:
    """One camera's lens, prepared for any number of pictures.

    Parameters
    ----------
    camera
        The real camera.
    optics
        Its lens.
    oversample
        Sub-samples per pixel, in each direction, and pixels of the pinholes per pixel.
    """

    def __init__(self, camera: Camera, optics: Optics, oversample: int) -> None:
        self.camera, self.optics, self.oversample = camera, optics, oversample
        self._kernel = _kernel(optics.psf_sigma_px, oversample)
        self._margin = int(np.ceil(len(self._kernel) / 2 / oversample)) + 1
        self._reach = self._margin + 0.5

    def make_pinholes(self, count: int) -> list[Pinhole]:
        """Return the pinholes for `integrate_pixels`; InputError where distortion folds inside the image."""
        return self._make_pinholes(count, self.oversample, self.optics.aperture_mm)

    def make_coarse_pinhole(self) -> Pinhole:
        """Return a pinhole of the camera's own resolution that covers the same view as the others."""
        return self._make_pinholes(1, 1, 0.0)[0]

    def integrate_pixels(
        self, pinholes: list[Pinhole], pictures: list[NDArray[np.float32]]
    ) -> NDArray[np.float32]:
        """Return the light on the camera's pixels, (H, W, 3) float32, from the pinholes' pictures (h, w, 3)."""
        import cv2

        bands: list[NDArray[np.float32]] = []
        for first, x, y in self._ideal_bands():
            light = np.zeros((*x.shape, 3), np.float32)
            for pinhole, picture in zip(pinholes, pictures, strict=True):
                columns, rows = pinhole.project(x, y)
                light += cv2.remap(
                    picture,
                    columns.astype(np.float32),
                    rows.astype(np.float32),
                    cv2.INTER_LINEAR,
                    borderMode=cv2.BORDER_REPLICATE,
                )
            bands.append(self._integrate_band(light / np.float32(len(pinholes)), first))
        return np.concatenate(bands)

    def _make_pinholes(self, count: int, oversample: int, aperture_mm: float) -> list[Pinhole]:
        return make_pinholes(self.camera, oversample, count, self._reach, aperture_mm, self.optics.focus_mm)

    def _ideal_bands(self) -> Iterator[tuple[int, NDArray[np.float64], NDArray[np.float64]]]:
        """Yield for each band of pixels its first row, and x/z and y/z of all its sub-samples, margin included.

        A quintic spline interpolates exactly undistorted nodes; it is accurate to 1e-9 px.
        """
        from scipy.interpolate import RectBivariateSpline

        (width, height), reach = self.camera.size_px, self._reach
        u = np.linspace(-reach, width - 1 + reach, max(7, int(width / _NODE_PX)))
        v = np.linspace(-reach, height - 1 + reach, max(7, int(height / _NODE_PX)))
        ideal = self.camera.undistort(np.stack(np.meshgrid(u, v), axis=-1))
        splines = [RectBivariateSpline(v, u, ideal[..., axis], kx=5, ky=5) for axis in (0, 1)]
        columns = self._sub_pixels(0, width)
        for first in range(0, height, _BAND_ROWS):
            rows = self._sub_pixels(first, min(first + _BAND_ROWS, height))
            yield first, splines[0](rows, columns), splines[1](rows, columns)

    def _sub_pixels(self, first: int, end: int) -> NDArray[np.float64]:
        """Return the centres of the sub-pixels of pixels first … end - 1 and of the margin on both sides."""
        n, margin = self.oversample, self._margin
        return first - margin - 0.5 + (np.arange((end - first + 2 * margin) * n) + 0.5) / n

    def _integrate_band(self, light: NDArray[np.float32], first: int) -> NDArray[np.float32]:
        """Return the light on the pixels of a band from the light on its sub-samples."""
        import cv2

        n, kernel = self.oversample, self._kernel
        # an even kernel's centre lies half a sub-pixel before its anchor, as a pixel's centre does
        blurred = cv2.sepFilter2D(light, cv2.CV_32F, kernel, kernel, anchor=(len(kernel) // 2,) * 2)
        at = self._margin * n + n // 2
        height, width = (size // n - 2 * self._margin for size in light.shape[:2])
        image = blurred[at : at + height * n : n, at : at + width * n : n]
        if self.optics.falloff > 0:
            pixels = np.stack(np.meshgrid(np.arange(int(width)), first + np.arange(int(height))), axis=-1)
            cosine = (1 + (self.camera.undistort(pixels) ** 2).sum(axis=-1, keepdims=True)) ** -0.5
            image = image * (cosine**self.optics.falloff).astype(np.float32)
        return np.ascontiguousarray(image, np.float32)


def _kernel(sigma_px: float, n: int) -> NDArray[np.float64]:
    """Return the weights of sub-samples about a pixel's centre: the pixel's area blurred by the lens.

    Interpolation between the pinholes' pixels already blurs by a variance of 1/6 of a sub-pixel squared; the Gaussian
    adds only the remainder.
    """
    from scipy.special import ndtr

    sigma = max(float(np.sqrt(max(sigma_px**2 - 1 / 6 / n**2, 0.0))), 1e-4)
    half = int(np.ceil((0.5 + 4 * sigma_px) * n))
    length = 2 * half + n % 2
    offsets = (np.arange(length) - (length - 1) / 2) / n
    weights = ndtr((offsets + 0.5) / sigma) - ndtr((offsets - 0.5) / sigma)
    return weights / weights.sum()
