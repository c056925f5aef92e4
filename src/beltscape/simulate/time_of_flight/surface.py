"""The surfaces in front of a time-of-flight camera: distances, normals, and reflected light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
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
