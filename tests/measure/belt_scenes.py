"""Belts with known solids on them, seen by a camera anywhere: exact depth by intersecting rays."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose

Rays = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Origin (3,) and directions (N, 3) in the world: x across, y along, z up, origin on the belt's middle."""


def trough(flat_mm: float, *wings: tuple[float, float]) -> NDArray[np.float64]:
    """(K, 2) cross-section x, z of a symmetric belt: half of the flat, then (length, degrees) of each wing."""
    right = [np.array([flat_mm / 2, 0.0])]
    for length, degrees in wings:
        angle = np.deg2rad(degrees)
        right.append(right[-1] + length * np.array([np.cos(angle), np.sin(angle)]))
    left = [point * [-1, 1] for point in right[::-1]]
    return np.array(left + right if flat_mm > 0 else left + right[1:])


def round_trough(radius_mm: float, half_deg: float) -> NDArray[np.float64]:
    """(K, 2) cross-section of a round belt."""
    angle = np.deg2rad(np.linspace(-half_deg, half_deg, 121))
    return radius_mm * np.column_stack([np.sin(angle), 1 - np.cos(angle)])


@dataclass(frozen=True)
class Block:
    center_mm: tuple[float, float]
    size_mm: tuple[float, float, float]
    yaw_deg: float = 0.0

    @property
    def volume_mm3(self) -> float:
        return float(np.prod(self.size_mm))

    def hit(self, rays: Rays) -> NDArray[np.float64]:
        origin, direction = _turned(rays, self.center_mm, self.yaw_deg)
        length, width, height = self.size_mm
        low, high = np.array([-length / 2, -width / 2, 0]), np.array([length / 2, width / 2, height])
        with np.errstate(divide="ignore"):
            one, two = (low - origin) / direction, (high - origin) / direction
        enter, leave = np.minimum(one, two).max(axis=1), np.maximum(one, two).min(axis=1)
        return np.where(enter < leave, enter, np.inf)


@dataclass(frozen=True)
class Slab:
    """A box between two corners, such as a rail, a board or a beam beside or over the belt."""

    low_mm: tuple[float, float, float]
    high_mm: tuple[float, float, float]

    def hit(self, rays: Rays) -> NDArray[np.float64]:
        with np.errstate(divide="ignore"):
            one, two = ((np.array(corner) - rays[0]) / rays[1] for corner in (self.low_mm, self.high_mm))
        enter, leave = np.minimum(one, two).max(axis=1), np.maximum(one, two).min(axis=1)
        return np.where(enter < leave, enter, np.inf)


@dataclass(frozen=True)
class HalfCylinder:
    center_mm: tuple[float, float]
    radius_mm: float
    length_mm: float
    yaw_deg: float = 0.0

    @property
    def volume_mm3(self) -> float:
        return float(0.5 * np.pi * self.radius_mm**2 * self.length_mm)

    def hit(self, rays: Rays) -> NDArray[np.float64]:
        origin, direction = _turned(rays, self.center_mm, self.yaw_deg)
        a = direction[:, 0] ** 2 + direction[:, 2] ** 2
        b = origin[0] * direction[:, 0] + origin[2] * direction[:, 2]
        root = b**2 - a * (origin[0] ** 2 + origin[2] ** 2 - self.radius_mm**2)
        with np.errstate(invalid="ignore", divide="ignore"):
            half = np.sqrt(root)
            ends = (np.array([[-0.5], [0.5]]) * self.length_mm - origin[1]) / direction[:, 1]
            enter = np.maximum((-b - half) / a, ends.min(axis=0))
            leave = np.minimum((-b + half) / a, ends.max(axis=0))
            return np.where((enter < leave) & (origin[2] + enter * direction[:, 2] > 0), enter, np.inf)


@dataclass(frozen=True)
class Cone:
    center_mm: tuple[float, float]
    radius_mm: float
    height_mm: float

    @property
    def volume_mm3(self) -> float:
        return float(np.pi * self.radius_mm**2 * self.height_mm / 3)

    def hit(self, rays: Rays) -> NDArray[np.float64]:
        origin, direction = _turned(rays, self.center_mm, 0.0)
        scale = np.array([1, 1, self.radius_mm / self.height_mm])
        p, d = (origin - [0, 0, self.height_mm]) * scale, direction * scale
        sign = np.array([1, 1, -1])
        a, b, c = (sign * d * d).sum(1), (sign * p * d).sum(1), (sign * p * p).sum()
        with np.errstate(invalid="ignore", divide="ignore"):
            half = np.sqrt(b * b - a * c)
            roots = np.stack([(-b - half) / a, (-b + half) / a])
        height = origin[2] + roots * direction[:, 2]
        return np.where((height > 0) & (height < self.height_mm) & (roots > 0), roots, np.inf).min(axis=0)


@dataclass(frozen=True)
class Ball:
    center_mm: tuple[float, float, float]
    radius_mm: float

    def hit(self, rays: Rays) -> NDArray[np.float64]:
        origin, direction = rays[0] - self.center_mm, rays[1]
        a, b = (direction**2).sum(1), direction @ origin
        with np.errstate(invalid="ignore"):
            near = (-b - np.sqrt(b * b - a * (origin @ origin - self.radius_mm**2))) / a
        return np.where(np.isfinite(near), near, np.inf)


Solid = Block | Slab | HalfCylinder | Cone | Ball


@dataclass(frozen=True)
class Scene:
    """A belt, and a floor below it, under a camera."""

    section_mm: NDArray[np.float64]
    solids: tuple[Solid, ...] = ()
    floor_mm: float | None = None
    belt_yaw_deg: float = 0.0
    """Of the belt about the world's z: turned in the image."""
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    """Of the camera about its u and v axes."""
    camera_mm: tuple[float, float, float] = (0.0, 0.0, 740.0)
    camera: Camera = field(default_factory=lambda: camera_of(306))

    @property
    def core_from_world(self) -> Pose:
        """Camera above the belt, image u along the world's x when nothing is turned."""
        down = np.diag([1.0, -1.0, -1.0])
        turn = Pose.of(np.deg2rad([self.tilt_deg[0], self.tilt_deg[1], 0.0]), np.zeros(3)).rotation
        yaw = Pose.of(np.deg2rad([0.0, 0.0, self.belt_yaw_deg]), np.zeros(3)).rotation
        rotation = turn @ down @ yaw
        return Pose(rotation, -rotation @ np.array(self.camera_mm))

    def depth_mm(self) -> NDArray[np.float64]:
        """(H, W) exact depth; NaN where the ray meets nothing."""
        pose = self.core_from_world
        rays = self.camera.rays()
        inside = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1).reshape(-1, 3)
        world = (pose.center_mm, inside @ pose.rotation)
        hit = self._belt(world)
        for solid in self.solids:
            hit = np.minimum(hit, solid.hit(world))
        if self.floor_mm is not None:
            hit = np.minimum(hit, (self.floor_mm - world[0][2]) / world[1][:, 2])
        return np.where(np.isfinite(hit), hit, np.nan).reshape(rays.shape[:2])

    def _belt(self, rays: Rays) -> NDArray[np.float64]:
        origin, direction = rays
        hit = np.full(len(direction), np.inf)
        for (x0, z0), (x1, z1) in zip(self.section_mm[:-1], self.section_mm[1:], strict=True):
            normal = np.array([z0 - z1, 0.0, x1 - x0])
            distance = (normal @ [x0, 0.0, z0] - normal @ origin) / (direction @ normal)
            x = origin[0] + distance * direction[:, 0]
            hit = np.where((x >= x0) & (x <= x1) & (distance > 0), np.minimum(hit, distance), hit)
        return hit


def world_points_mm(scene: Scene, depth_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """(H, W, 3) the pixels' points in the world."""
    points = np.concatenate([scene.camera.rays() * depth_mm[..., None], depth_mm[..., None]], axis=-1)
    return scene.core_from_world.inverse().apply(points)


@cache
def camera_of(width: int) -> Camera:
    """A camera of 55° across, principal point off the middle."""
    height = round(width * 0.84)
    return Camera(
        "cam0",
        (width, height),
        np.array([0.95 * width, 0.95 * width]),
        np.array([0.508 * width, 0.502 * height]),
        np.zeros(5),
    )


def depth_map(
    depth_mm: NDArray[np.float64],
    *,
    noise_mm: float = 0.0,
    window_px: int = 5,
    seed: int = 0,
    holes: float = 0.0,
    gross: float = 0.0,
) -> DepthMap:
    """Depth map with a window matcher's noise, round holes over a share of it, and a share of gross errors."""
    rng = np.random.default_rng(seed)
    depth = depth_mm.copy()
    if noise_mm:
        noise = ndimage.uniform_filter(rng.standard_normal(depth.shape), window_px, mode="wrap")
        depth += noise_mm * window_px * noise
    if holes:
        seeds = rng.random(depth.shape) < holes / 60
        depth[ndimage.distance_transform_edt(~seeds) < 4.4] = np.nan
    if gross:
        wrong = rng.random(depth.shape) < gross
        depth[wrong] += rng.normal(0, 40, int(wrong.sum()))
    sigma = np.full(depth.shape, max(noise_mm, 1e-3), np.float32)
    views = np.full(depth.shape, 4, np.uint8)
    return DepthMap(depth.astype(np.float32), sigma, views, np.isfinite(depth).astype(np.float32))


def _turned(rays: Rays, center_mm: tuple[float, float], yaw_deg: float) -> Rays:
    c, s = np.cos(np.deg2rad(yaw_deg)), np.sin(np.deg2rad(yaw_deg))
    turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
    return turn @ (rays[0] - [*center_mm, 0.0]), rays[1] @ turn.T
