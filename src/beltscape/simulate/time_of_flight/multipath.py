"""Light that reaches a surface over another one: longer on its way, it turns a pixel's phasor.

One bounce between diffuse surfaces. The image is cut into blocks; the surface in the middle of each stands for it as
a disc of the block's area, lit by the camera. What a receiving point gets of a disc is the radiosity form factor

    F = cos θ cos θ' A / (π r² + A)

and the light's way is camera – disc – point – camera. It is summed at every few pixels and interpolated between.
Left out: what hides a disc from a point, surfaces outside the image or hidden from the camera, more bounces, gloss.
The same model, fitted instead of applied, is in Jiménez et al., Image and Vision Computing 32(1), 2014, 1-13.
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
"""Pairs of points and discs at a time."""


def compute_one_bounce(
    surface: TofSurface, settings: TofSettings, frequency_hz: float
) -> NDArray[np.complex128]:
    """(H, W) phasor of the light over one second surface, in units of `TofSurface.strength`."""
    discs, points = _block_centres(surface, settings.patch_px), _block_centres(surface, settings.receiver_px)
    albedo = surface.average_pixels(surface.albedo)
    area = _areas_mm2(surface, settings.patch_px)[discs]
    lit = (
        albedo[discs]
        * _cosine(surface)[discs]
        / (np.linalg.norm(surface.points_mm[discs], axis=1) / 1000) ** 2
    )
    known = np.isfinite(surface.normals[points]).all(axis=1)
    arriving = np.zeros(len(points[0]), np.complex128)
    discs_at, discs_to = surface.points_mm[discs], surface.normals[discs]
    use = np.isfinite(lit) & np.isfinite(area)
    sources = (discs_at[use], discs_to[use], area[use], lit[use])
    which = np.flatnonzero(known)
    rows = max(1, _PAIRS // max(1, int(use.sum())))
    for start in range(0, len(which), rows):
        some = which[start : start + rows]
        at = (points[0][some], points[1][some])
        arriving[some] = integrate_irradiance(
            surface.points_mm[at], surface.normals[at], sources, frequency_hz
        )
    grid = _reshape(arriving, surface, settings.receiver_px)
    return albedo * _interpolate(grid, surface.hit.shape, settings.receiver_px)


def integrate_irradiance(
    points: Array, normals: Array, sources: tuple[Array, Array, Array, Array], frequency_hz: float
) -> NDArray[np.complex128]:
    """(N,) phasor of irradiance at points (N, 3) from discs: places, normals, areas mm², their radiosity."""
    at, facing, area, lit = sources
    way = at[None] - points[:, None]
    distance2 = (way**2).sum(axis=-1)
    here = np.einsum("nmi,ni->nm", way, normals).clip(min=0)
    there = (-np.einsum("nmi,mi->nm", way, facing)).clip(min=0)
    near = np.maximum(distance2, 1e-9)
    share = here * there / near * area / (np.pi * near + area)
    length = np.linalg.norm(at, axis=1)[None] + np.sqrt(distance2) + np.linalg.norm(points, axis=1)[:, None]
    phase = 2 * np.pi * frequency_hz / LIGHT_MM_S * length
    return ((share * lit) * np.exp(1j * phase)).sum(axis=1)


def _block_centres(surface: TofSurface, step: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of the pixels in the middles of step×step blocks."""
    rows, columns = (np.arange(step // 2, n, step) for n in surface.hit.shape)
    row, column = np.meshgrid(rows, columns, indexing="ij")
    return row.ravel(), column.ravel()


def _cosine(surface: TofSurface) -> Array:
    """(H, W) between normal and the way back to the camera; NaN where unknown."""
    return -(surface.normals * surface.rays).sum(axis=-1) / np.linalg.norm(surface.rays, axis=-1)


def _areas_mm2(surface: TofSurface, step: int) -> Array:
    """(H, W) area of surface behind a step×step block about each pixel: its solid angle · distance² / cosine."""
    du = surface.rays[0, 1, 0] - surface.rays[0, 0, 0]
    dv = surface.rays[1, 0, 1] - surface.rays[0, 0, 1]
    slant = np.linalg.norm(surface.rays, axis=-1) * np.maximum(_cosine(surface), 0.05)
    return surface.points_mm[..., 2] ** 2 * du * dv * step**2 / slant


def _reshape(values: NDArray[np.complex128], surface: TofSurface, step: int) -> NDArray[np.complex128]:
    rows, columns = (len(range(step // 2, n, step)) for n in surface.hit.shape)
    return values.reshape(rows, columns)


def _interpolate(grid: NDArray[np.complex128], shape: tuple[int, ...], step: int) -> NDArray[np.complex128]:
    """(H, W) values of pixels between those of the grid, bilinear; constant beyond its rim."""
    rows, columns = ((np.arange(n) - step // 2) / step for n in shape)
    x, y = (grid.astype(np.float32) for grid in np.meshgrid(columns, rows))
    parts = [
        cv2.remap(np.ascontiguousarray(part), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for part in (grid.real, grid.imag)
    ]
    return parts[0].astype(np.float64) + 1j * parts[1].astype(np.float64)
