"""Ellipsoids and boxes on a plane below a vertical camera: exact depth, and the visible solid of each pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera

FLOOR_MM = 700.0
"""Depth of the plane."""


@dataclass(frozen=True)
class Solid:
    """An ellipsoid or a box by its half axes, rotated about the vertical."""

    center_mm: tuple[float, float, float]
    half_mm: tuple[float, float, float]
    yaw_deg: float = 0.0
    box: bool = False

    @property
    def size_mm(self) -> float:
        return 2 * sorted(self.half_mm)[1]

    @property
    def volume_mm3(self) -> float:
        return (8.0 if self.box else 4 / 3 * np.pi) * float(np.prod(self.half_mm))

    def hit(self, rays: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the depth (H, W) at which rays x/z, y/z (H, W, 2) from the origin enter; inf beside the solid."""
        cosine, sine = np.cos(np.deg2rad(self.yaw_deg)), np.sin(np.deg2rad(self.yaw_deg))
        turn = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]]) / np.array(self.half_mm)[:, None]
        ray = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1) @ turn.T
        eye = -turn @ np.array(self.center_mm)
        if self.box:
            with np.errstate(divide="ignore", invalid="ignore"):
                one, two = (-1 - eye) / ray, (1 - eye) / ray
            near, far = np.minimum(one, two).max(axis=-1), np.maximum(one, two).min(axis=-1)
            return np.where(near < far, near, np.inf)
        a, b, c = (ray**2).sum(axis=-1), ray @ eye, eye @ eye - 1
        inside = b * b - a * c
        return np.where(inside > 0, (-b - np.sqrt(np.maximum(inside, 0))) / a, np.inf)


def camera(width: int = 600, height: int = 500, focal_px: float = 700.0) -> Camera:
    center = np.array([(width - 1) / 2, (height - 1) / 2])
    return Camera("core", (width, height), np.full(2, focal_px), center, np.zeros(5))


def render_depth_map(
    solids: list[Solid], eye: Camera, *, scale: float = 1.0, noise_mm: float = 0.0, seed: int = 0
) -> tuple[DepthMap, NDArray[np.int32]]:
    """Return the depth map of solids on the plane, and (H, W) the index of the visible solid, -1 for the plane."""
    rays = eye.rays()
    depth = np.stack([np.full(rays.shape[:2], FLOOR_MM), *(solid.hit(rays) for solid in solids)])
    which = depth.argmin(axis=0).astype(np.int32) - 1
    nearest = depth.min(axis=0) * scale
    nearest += noise_mm * np.random.default_rng(seed).normal(size=nearest.shape)
    return depth_map(nearest), which


def depth_map(depth_mm: NDArray[np.floating]) -> DepthMap:
    is_known = np.isfinite(depth_mm)
    sigma = np.where(is_known, 0.05, np.nan).astype(np.float32)
    return DepthMap(
        depth_mm.astype(np.float32), sigma, is_known.astype(np.uint8), is_known.astype(np.float32)
    )


def make_ellipsoids(
    rng: np.random.Generator,
    columns: int = 6,
    rows: int = 5,
    pitch_mm: float = 78.0,
    largest_mm: float = 36.0,
) -> list[Solid]:
    """Return flat ellipsoids on a loose grid; they do not touch, and none is cut by the image border."""
    solids = []
    for i in range(columns):
        for j in range(rows):
            a = rng.uniform(0.55, 1.0) * largest_mm
            half = (a, a * rng.uniform(0.75, 1.0), a * rng.uniform(0.55, 0.75))
            x, y = (i - (columns - 1) / 2) * pitch_mm, (j - (rows - 1) / 2) * pitch_mm
            position = (x + rng.uniform(-3, 3), y + rng.uniform(-3, 3), FLOOR_MM - 0.9 * half[2])
            solids.append(Solid(position, half, yaw_deg=rng.uniform(0, 180)))
    return solids
