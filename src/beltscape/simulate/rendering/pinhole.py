"""The ideal pinholes that are rendered for one camera: finer than its pixels, covering its whole image."""

from __future__ import annotations

from dataclasses import dataclass
from math import gcd

import numpy as np
from numpy.typing import NDArray

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
