"""Multipath of a time-of-flight camera: light over a second surface travels farther and shifts a pixel's phasor.

One bounce between diffuse surfaces is simulated. The image is divided into blocks; the surface at the centre of each
represents it as a disc of the block's area, lit by the camera. The share of a disc's light that a receiving point
gets is the radiosity form factor

    F = cos θ cos θ' A / (π r² + A)

and the light's path is camera – disc – point – camera. It is summed at every few pixels and interpolated in between.
Not modelled: occlusion between disc and point, surfaces outside the image or hidden from the camera, further bounces,
gloss. Jiménez et al., Image and Vision Computing 32(1), 2014, 1-13, fit the same model instead of applying it.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from beltscape.simulate.time_of_flight.phase import LIGHT_MM_S
from beltscape.simulate.time_of_flight.settings import TofSettings
from beltscape.simulate.time_of_flight.surface import TofSurface

Array = NDArray[np.float64]

_PAIRS = 1 << 19
"""Pairs of points and discs processed at a time."""


def compute_one_bounce(
    surface: TofSurface, settings: TofSettings, frequency_hz: float
) -> NDArray[np.complex128]:
    """Return (H, W) phasor of the light over one second surface, in units of `TofSurface.strength`."""
    discs, points = _block_centres(surface, settings.patch_px), _block_centres(surface, settings.receiver_px)
    albedo = surface.average_pixels(surface.albedo)
    area = _areas_mm2(surface, settings.patch_px)[discs]
    radiosity = (
        albedo[discs]
        * _cosine(surface)[discs]
        / (np.linalg.norm(surface.points_mm[discs], axis=1) / 1000) ** 2
    )
    has_normal = np.isfinite(surface.normals[points]).all(axis=1)
    irradiance = np.zeros(len(points[0]), np.complex128)
    disc_points, disc_normals = surface.points_mm[discs], surface.normals[discs]
    is_source = np.isfinite(radiosity) & np.isfinite(area)
    sources = (disc_points[is_source], disc_normals[is_source], area[is_source], radiosity[is_source])
    receivers = np.flatnonzero(has_normal)
    rows = max(1, _PAIRS // max(1, int(is_source.sum())))
    for start in range(0, len(receivers), rows):
        chunk = receivers[start : start + rows]
        receiver = (points[0][chunk], points[1][chunk])
        irradiance[chunk] = integrate_irradiance(
            surface.points_mm[receiver], surface.normals[receiver], sources, frequency_hz
        )
    grid = _reshape(irradiance, surface, settings.receiver_px)
    return albedo * _interpolate(grid, surface.hit.shape, settings.receiver_px)


def integrate_irradiance(
    points: Array, normals: Array, sources: tuple[Array, Array, Array, Array], frequency_hz: float
) -> NDArray[np.complex128]:
    """Return (N,) phasor of irradiance at points (N, 3) from discs: positions, normals, areas mm², radiosity."""
    positions, source_normals, area, radiosity = sources
    to_source = positions[None] - points[:, None]
    distance2 = (to_source**2).sum(axis=-1)
    receiver_cosine = np.einsum("nmi,ni->nm", to_source, normals).clip(min=0)
    source_cosine = (-np.einsum("nmi,mi->nm", to_source, source_normals)).clip(min=0)
    squared = np.maximum(distance2, 1e-9)
    form_factor = receiver_cosine * source_cosine / squared * area / (np.pi * squared + area)
    length = (
        np.linalg.norm(positions, axis=1)[None] + np.sqrt(distance2) + np.linalg.norm(points, axis=1)[:, None]
    )
    phase = 2 * np.pi * frequency_hz / LIGHT_MM_S * length
    return ((form_factor * radiosity) * np.exp(1j * phase)).sum(axis=1)


def _block_centres(surface: TofSurface, step: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows and columns of the pixels at the centres of step×step blocks."""
    rows, columns = (np.arange(step // 2, int(n), step) for n in surface.hit.shape)
    row, column = np.meshgrid(rows, columns, indexing="ij")
    return row.ravel(), column.ravel()


def _cosine(surface: TofSurface) -> Array:
    """Return (H, W) cosines of normal and direction to the camera; NaN where unknown."""
    return -(surface.normals * surface.rays).sum(axis=-1) / np.linalg.norm(surface.rays, axis=-1)


def _areas_mm2(surface: TofSurface, step: int) -> Array:
    """Return (H, W) area of surface behind a step×step block at each pixel: solid angle · distance² / cosine."""
    du = surface.rays[0, 1, 0] - surface.rays[0, 0, 0]
    dv = surface.rays[1, 0, 1] - surface.rays[0, 0, 1]
    slant = np.linalg.norm(surface.rays, axis=-1) * np.maximum(_cosine(surface), 0.05)
    return surface.points_mm[..., 2] ** 2 * du * dv * step**2 / slant


def _reshape(values: NDArray[np.complex128], surface: TofSurface, step: int) -> NDArray[np.complex128]:
    rows, columns = (len(range(step // 2, n, step)) for n in surface.hit.shape)
    return values.reshape(rows, columns)


def _interpolate(grid: NDArray[np.complex128], shape: tuple[int, ...], step: int) -> NDArray[np.complex128]:
    """Return (H, W) values of pixels between those of the grid, bilinear; constant beyond its border."""
    rows, columns = ((np.arange(n) - step // 2) / step for n in shape)
    x, y = (grid.astype(np.float32) for grid in np.meshgrid(columns, rows))
    parts = [
        cv2.remap(np.ascontiguousarray(part), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for part in (grid.real, grid.imag)
    ]
    return parts[0].astype(np.float64) + 1j * parts[1].astype(np.float64)
