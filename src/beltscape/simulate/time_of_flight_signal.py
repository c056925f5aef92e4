"""The signal of a time-of-flight camera: settings, surfaces in front of it, and distances from phases.

Surfaces have distances, normals and reflected light. Phases have a standard deviation and an unambiguous range; those
of several frequencies are combined.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from math import gcd
from typing import Annotated, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.arrays import Array

_Value = TypeVar("_Value", bound=np.inexact)


@dataclass(frozen=True, slots=True, eq=False)
class TofSurface:
    """The surfaces per sub-pixel, s×s in a pixel; the strength is 0 where there is no surface."""

    samples: int
    """s."""
    rays: Array
    """(H, W, 3) rays through the pixel centres, z = 1."""
    distance_mm: Array
    """(H·s, W·s) distance along the ray; 0: no surface."""
    albedo: Array
    """(H·s, W·s)."""
    strength: Array
    """(H·s, W·s) albedo · cosine / distance² in m²: light relative to a white surface facing the camera at 1 m."""
    hit: NDArray[np.bool_]
    """(H, W) whether at least one of a pixel's rays hits a surface."""
    points_mm: Array
    """(H, W, 3) the point of one ray near each pixel's centre; NaN: no surface."""
    normals: Array
    """(H, W, 3) normals at these points, towards the camera; NaN: unknown."""

    def average_pixels(self, values: NDArray[_Value]) -> NDArray[_Value]:
        """Return the mean over each pixel: (H·s, W·s) → (H, W)."""
        rows, columns = (n // self.samples for n in values.shape)
        return values.reshape(rows, self.samples, columns, self.samples).mean(axis=(1, 3))


def make_surface(
    depth_mm: Array, albedo: Array, cosine: Array | None, rays: Array, samples: int
) -> TofSurface:
    """Return the surfaces from true depth (H·s, W·s) along rays (H·s, W·s, 2) x/z, y/z; s ``samples`` per pixel.

    Without cosines these are computed from the depth: each axis uses the smaller of the differences to both
    neighbours, so that normals at a step are not tilted.
    """
    length = np.sqrt(1 + (rays**2).sum(axis=-1))
    is_hit = np.isfinite(depth_mm) & (depth_mm > 0)
    depth = np.where(is_hit, depth_mm, np.nan)
    if cosine is None:
        cosine = _estimate_cosines(depth, rays, length)
    distance = np.where(is_hit, depth * length, 0.0)
    strength = np.where(
        is_hit, albedo * np.clip(cosine, 0, 1) / np.where(is_hit, distance / 1000, 1) ** 2, 0.0
    )
    middle = (slice(samples // 2, None, samples),) * 2
    points = _unproject(depth[middle], rays[middle])
    rows, columns = (n // samples for n in depth_mm.shape)
    centres = rays.reshape(rows, samples, columns, samples, 2).mean(axis=(1, 3))
    return TofSurface(
        samples=samples,
        rays=np.concatenate([centres, np.ones((rows, columns, 1))], axis=-1),
        distance_mm=distance,
        albedo=np.where(is_hit, albedo, 0.0),
        strength=strength,
        hit=np.asarray(is_hit.reshape(rows, samples, columns, samples).any(axis=(1, 3))),
        points_mm=points,
        normals=_estimate_normals(points),
    )


def _unproject(depth_mm: Array, rays: Array) -> Array:
    """Return (H, W, 3) points in the camera frame; NaN where there is no depth."""
    return np.concatenate([rays * depth_mm[..., None], depth_mm[..., None]], axis=-1)


def _estimate_cosines(depth_mm: Array, rays: Array, length: Array) -> Array:
    """Return (H, W) cosines of surface normal and ray; 1 where the normal is unknown."""
    normals = _estimate_normals(_unproject(depth_mm, rays))
    cosine = -((normals[..., :2] * rays).sum(axis=-1) + normals[..., 2]) / length
    return np.where(np.isfinite(cosine), cosine, 1.0)


def _estimate_normals(points: Array) -> Array:
    """Return (H, W, 3) unit normals towards the camera; NaN where both neighbours on an axis are missing."""
    down, right = _smaller_difference(points, 0), _smaller_difference(points, 1)
    normal = np.cross(down, right)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    normal = np.divide(normal, length, out=np.full_like(normal, np.nan), where=length > 0)
    return np.where((normal * points).sum(axis=-1, keepdims=True) > 0, -normal, normal)


def _smaller_difference(points: Array, axis: int) -> Array:
    """Return the shorter of the differences to the next and the previous point along an axis; NaN without both."""
    step = np.diff(points, axis=axis)
    missing = np.full_like(np.take(points, [0], axis=axis), np.nan)
    ahead, behind = np.concatenate([step, missing], axis), np.concatenate([missing, step], axis)
    ahead_length, behind_length = (
        np.linalg.norm(ahead, axis=-1, keepdims=True),
        np.linalg.norm(behind, axis=-1, keepdims=True),
    )
    return np.where(~np.isfinite(behind_length) | (ahead_length < behind_length), ahead, behind)


LIGHT_MM_S = 299_792_458_000.0
"""Speed of light (SI, exact)."""


def unambiguous_range_mm(frequency_hz: float) -> float:
    """Return the distance after which one frequency's phase repeats, c / 2f."""
    return LIGHT_MM_S / (2 * frequency_hz)


def common_range_mm(frequencies_hz: Sequence[float]) -> float:
    """Return the unambiguous range of all frequencies together: of their greatest common divisor, in whole kHz."""
    return unambiguous_range_mm(reduce(gcd, (round(f / 1000) for f in frequencies_hz)) * 1000)


def distance_sigma_mm(noise_e: Array, amplitude_e: Array, frequencies_hz: Sequence[float]) -> Array:
    """Return (n, H, W) σ of the distance at each frequency: c / 4πf · noise over amplitude (Lange & Seitz 2001).

    ``noise_e`` (H, W) is the noise of one component, ``amplitude_e`` (n, H, W) the amplitude of the phasor.
    """
    scale = LIGHT_MM_S / (4 * np.pi * np.asarray(frequencies_hz))
    return scale[:, None, None] * noise_e / amplitude_e


def combine_phases(phases: Array, sigma_mm: Array, frequencies_hz: Sequence[float]) -> tuple[Array, Array]:
    """Return the distance (H, W) and its σ from phases (n, H, W).

    Of all repetitions of the highest frequency within the common range, the one with which the other frequencies
    agree best is taken; the distance is then the mean weighted by 1/σ². With one frequency it lies within that
    frequency's range.
    """
    ranges = np.array([unambiguous_range_mm(f) for f in frequencies_hz])
    distances = np.mod(phases, 2 * np.pi) / (2 * np.pi) * ranges[:, None, None]
    base = int(np.argmin(ranges))
    best: Array = distances[base]
    best_cost: Array = np.full(distances.shape[1:], np.inf)
    for wrap in range(round(common_range_mm(frequencies_hz) / ranges[base])):
        candidate: Array = distances[base] + wrap * ranges[base]
        difference = _wrap(distances - candidate, ranges)
        cost: Array = (difference**2 / (sigma_mm**2 + sigma_mm[base] ** 2)).sum(axis=0)
        best, best_cost = np.where(cost < best_cost, candidate, best), np.minimum(cost, best_cost)
    weight = 1 / sigma_mm**2
    shift = (weight * _wrap(distances - best, ranges)).sum(axis=0) / weight.sum(axis=0)
    return best + shift, np.sqrt(1 / weight.sum(axis=0))


def _wrap(difference: Array, ranges: Array) -> Array:
    """Return differences (n, H, W) wrapped to within half a period of zero."""
    period = ranges[:, None, None]
    return difference - np.round(difference / period) * period


Angle = Annotated[float, Field(gt=1, lt=150)]
Frequency = Annotated[float, Field(ge=1e6, le=1e9)]


class TofSettings(BaseModel):
    """The geometry of the paper's camera; all other values are those of a typical camera."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    size_px: tuple[Annotated[int, Field(ge=8, le=4096)], Annotated[int, Field(ge=8, le=4096)]] = (640, 480)
    angle_deg: tuple[Angle, Angle] = (43.0, 33.0)
    """Horizontal and vertical angle of view."""
    modulation_hz: Annotated[tuple[Frequency, ...], Field(min_length=1, max_length=3)] = (25e6,)
    """Whole kHz; the range of 25 MHz is 6.0 m. Several frequencies have the range of their common divisor."""
    amplitude_e: Annotated[float, Field(gt=0, le=1e15)] = 100_000.0
    """Electrons in one of the four samples from a white surface that faces the camera at 1 m."""
    contrast: Annotated[float, Field(gt=0, le=1)] = 0.5
    """Demodulation contrast."""
    ambient_e: Annotated[float, Field(ge=0, le=1e12)] = 5_000.0
    """Electrons in one of the four samples from a white surface under the ambient light."""
    read_noise_e: Annotated[float, Field(ge=0, le=1e6)] = 30.0
    full_well_e: Annotated[float, Field(gt=0)] = 400_000.0
    """Pixels with more electrons are not measured."""
    min_amplitude_e: Annotated[float, Field(ge=0)] = 100.0
    """Pixels with a smaller amplitude are not measured."""
    harmonics: tuple[Annotated[float, Field(ge=-0.3, le=0.3)], Annotated[float, Field(ge=-0.3, le=0.3)]] = (
        0.006,
        0.002,
    )
    """Third and fifth harmonic after the maker's correction: 0.006 causes 6 mm of wiggling at 25 MHz."""
    intensity_error_mm: Annotated[float, Field(ge=-1000, le=1000)] = 4.0
    """Error of the distance in the limit of dark pixels."""
    intensity_half_e: Annotated[float, Field(gt=0)] = 5_000.0
    """Amplitude at which half of this error is left."""
    scatter: Annotated[float, Field(ge=0, lt=1)] = 0.003
    """Share of the light that the lens scatters evenly over the image."""
    multipath: bool = True
    """Whether light over one second surface is simulated."""
    patch_px: Annotated[int, Field(ge=2, le=256)] = 16
    """Edge of the image blocks that represent second surfaces."""
    receiver_px: Annotated[int, Field(ge=1, le=64)] = 4
    """Spacing of the pixels at which the light from second surfaces is computed; it is interpolated in between."""
