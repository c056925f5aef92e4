"""A camera's lens: from pictures of ideal pinholes to the light on each pixel of the real camera.

Distortion is exact: every pixel has its own grid of sub-samples, each undistorted to its position in the pinholes'
fine pictures and weighted by the lens's blur and the pixel's area.

The ideal pinholes that are rendered for one camera are finer than its pixels and cover its whole image.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import gcd
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera


@dataclass(frozen=True, slots=True, eq=False)
class Pinhole:
    """A pinhole without distortion on the optical axis of a camera."""

    focal_px: float
    film_px: tuple[int, int]
    """(width, height) of the film, centred on the axis."""
    crop_px: tuple[int, int, int, int]
    """Left, top, width, height of the rendered part of the film."""
    shift_px: tuple[float, float] = (0.0, 0.0)
    """Offset of the axis to the right of and below the film's centre."""
    lens_mm: tuple[float, float] = (0.0, 0.0)
    """Position of the hole in the lens: x, y in the camera frame."""
    focus_mm: float = 1.0
    """Depth at which the images of all holes of the lens coincide."""

    @property
    def fov_deg(self) -> float:
        """Return the full angle across the film's width."""
        return float(np.rad2deg(2 * np.arctan(self.film_px[0] / 2 / self.focal_px)))

    def project(
        self, x: NDArray[np.float64], y: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return columns and rows (0 at the first pixel centre) for x/z and y/z through the lens's centre."""
        columns, rows = (
            (ideal - lens / self.focus_mm) * self.focal_px + film / 2 - 0.5 - crop + shift
            for ideal, lens, film, crop, shift in zip(
                (x, y), self.lens_mm, self.film_px, self.crop_px, self.shift_px, strict=False
            )
        )
        return columns, rows


def make_pinholes(
    camera: Camera, oversample: int, count: int, margin_px: float, aperture_mm: float, focus_mm: float
) -> list[Pinhole]:
    """Return ``count`` pinholes whose pixel centres interleave, spread over the lens's aperture.

    Parameters
    ----------
    oversample
        Pixels of a pinhole per pixel of the camera, on its axis.
    margin_px
        Margin beyond the camera's image.

    Raises
    ------
    InputError
        If the camera's distortion cannot be inverted within the image and its margin.
    """
    focal = oversample * float(camera.focal_px.mean())
    border = _undistort_border(camera, margin_px)
    spare = aperture_mm / 2 / focus_mm * focal + 3
    low, high = border.min(axis=0) * focal - spare, border.max(axis=0) * focal + spare
    half = np.ceil(np.maximum(-low, high)).astype(int)
    first, last = np.floor(low).astype(int) + half, np.ceil(high).astype(int) + half
    film = (2 * int(half[0]), 2 * int(half[1]))
    crop = (int(first[0]), int(first[1]), int(last[0] - first[0]), int(last[1] - first[1]))
    return [
        Pinhole(focal, film, crop, shift, lens, focus_mm)
        for shift, lens in zip(
            _interleaved_offsets(count), _spread_over_disc(count, aperture_mm), strict=True
        )
    ]


def _interleaved_offsets(count: int) -> list[tuple[float, float]]:
    """Return offsets within ±0.5 on a lattice, so that edges of any direction are sampled at even distances.

    It is the rank-1 lattice whose generator is nearest to the golden section; Fibonacci numbers are best. The order
    also spreads consecutive offsets, because a moving scene takes them one after another.
    """
    coprime = [step for step in range(1, count + 1) if gcd(step, count) == 1]
    step = min(coprime, key=lambda s: abs(s - count * 0.618034))
    stride = max(coprime, key=lambda s: _min_squared_distance(count, (1, s, s * step)))
    order = np.arange(count) * stride % count
    shifts = (np.column_stack([order, order * step % count]) + 0.5) / count - 0.5
    return [(float(x), float(y)) for x, y in shifts]


def _min_squared_distance(count: int, generator: tuple[int, ...]) -> float:
    """Return the smallest squared distance between points of the periodic lattice of multiples of a generator."""
    points = np.outer(np.arange(1, count), generator) % count
    return float((np.minimum(points, count - points) ** 2).sum(axis=1).min(initial=count**2))


def _spread_over_disc(count: int, aperture_mm: float) -> list[tuple[float, float]]:
    """Return points spread evenly over a disc (Vogel's spiral)."""
    k = np.arange(count)
    radius, angle = aperture_mm / 2 * np.sqrt((k + 0.5) / count), k * np.pi * (3 - np.sqrt(5))
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    points -= points.mean(axis=0)  # so that blur does not shift
    return [(float(x), float(y)) for x, y in points]


def _undistort_border(camera: Camera, margin_px: float) -> NDArray[np.float64]:
    """Return (N, 2) x/z, y/z along the border of the image and its margin."""
    width, height = camera.size_px
    u, v = np.arange(-margin_px, width + margin_px), np.arange(-margin_px, height + margin_px)
    sides = [np.column_stack([u, np.full_like(u, at)]) for at in (v[0], v[-1])]
    sides += [np.column_stack([np.full_like(v, at), v]) for at in (u[0], u[-1])]
    border = camera.undistort(np.concatenate(sides))
    if np.isnan(border).any():
        values = ", ".join(f"{value:g}" for value in camera.distortion)
        raise InputError(
            f"camera {camera.name}: distortion [{values}] folds inside the image; take smaller coefficients"
        )
    return border


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
            light /= np.float32(len(pinholes))
            bands.append(self._integrate_band(light, first))
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
