"""The surfaces before a time-of-flight camera: distances, normals, and how much light comes back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class TofSurface:
    """Per sub-pixel, s×s of them in a pixel; 0 for strength where there is nothing."""

    samples: int
    """s."""
    rays: Array
    """(H, W, 3) through the pixels' centres, z = 1."""
    distance_mm: Array
    """(H·s, W·s) straight to the surface; 0: nothing."""
    albedo: Array
    """(H·s, W·s)."""
    strength: Array
    """(H·s, W·s) albedo · cosine / distance² in m²: light back, over that of a white surface facing it at 1 m."""
    hit: NDArray[np.bool_]
    """(H, W) at least one of a pixel's rays meets something."""
    points_mm: Array
    """(H, W, 3) of one ray near each pixel's centre; NaN: nothing."""
    normals: Array
    """(H, W, 3) there, towards the camera; NaN: unknown."""

    def average_pixels(self, values: NDArray) -> NDArray:
        """Mean over each pixel: (H·s, W·s) → (H, W)."""
        rows, columns = (n // self.samples for n in values.shape)
        return values.reshape(rows, self.samples, columns, self.samples).mean(axis=(1, 3))


def make_surface(
    depth_mm: Array, albedo: Array, cosine: Array | None, rays: Array, samples: int
) -> TofSurface:
    """Surfaces from true depth (H·s, W·s) along rays (H·s, W·s, 2) x/z, y/z, with s ``samples`` per pixel.

    Without cosines they come from the depth: each axis takes the smaller of the differences to both neighbours, so
    that a normal does not lean over a step.
    """
    length = np.sqrt(1 + (rays**2).sum(axis=-1))
    met = np.isfinite(depth_mm) & (depth_mm > 0)
    depth = np.where(met, depth_mm, np.nan)
    if cosine is None:
        cosine = _estimate_cosines(depth, rays, length)
    distance = np.where(met, depth * length, 0.0)
    back = np.where(met, albedo * np.clip(cosine, 0, 1) / np.where(met, distance / 1000, 1) ** 2, 0.0)
    middle = (slice(samples // 2, None, samples),) * 2
    points = _unproject(depth[middle], rays[middle])
    rows, columns = (n // samples for n in depth_mm.shape)
    centres = rays.reshape(rows, samples, columns, samples, 2).mean(axis=(1, 3))
    return TofSurface(
        samples=samples,
        rays=np.concatenate([centres, np.ones((rows, columns, 1))], axis=-1),
        distance_mm=distance,
        albedo=np.where(met, albedo, 0.0),
        strength=back,
        hit=met.reshape(rows, samples, columns, samples).any(axis=(1, 3)),
        points_mm=points,
        normals=_estimate_normals(points),
    )


def _unproject(depth_mm: Array, rays: Array) -> Array:
    """(H, W, 3) in the camera's frame; NaN where there is no depth."""
    return np.concatenate([rays * depth_mm[..., None], depth_mm[..., None]], axis=-1)


def _estimate_cosines(depth_mm: Array, rays: Array, length: Array) -> Array:
    """(H, W) between surface normal and ray; 1 where the normal is unknown."""
    normals = _estimate_normals(_unproject(depth_mm, rays))
    cosine = -((normals[..., :2] * rays).sum(axis=-1) + normals[..., 2]) / length
    return np.where(np.isfinite(cosine), cosine, 1.0)


def _estimate_normals(points: Array) -> Array:
    """(H, W, 3) unit normals towards the camera; NaN where a neighbour is missing on both sides of an axis."""
    down, right = _smaller_difference(points, 0), _smaller_difference(points, 1)
    normal = np.cross(down, right)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    normal = np.divide(normal, length, out=np.full_like(normal, np.nan), where=length > 0)
    return np.where((normal * points).sum(axis=-1, keepdims=True) > 0, -normal, normal)


def _smaller_difference(points: Array, axis: int) -> Array:
    """To the next or from the previous point along an axis, whichever is shorter; NaN where there is neither."""
    step = np.diff(points, axis=axis)
    missing = np.full_like(np.take(points, [0], axis=axis), np.nan)
    ahead, behind = np.concatenate([step, missing], axis), np.concatenate([missing, step], axis)
    far, near = np.linalg.norm(ahead, axis=-1, keepdims=True), np.linalg.norm(behind, axis=-1, keepdims=True)
    return np.where(~np.isfinite(near) | (far < near), ahead, behind)
