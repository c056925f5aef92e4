"""Boxes, spheres and upright cylinders of a module: ray intersection, signed distance, and height.

The nominal module is rendered in the core camera's view.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.target.module import Cube, Feature, Module, Sphere

Points = NDArray[np.float64]


class ConvexBody(Protocol):
    """A convex body in the module's frame, mm."""

    def intersect(self, origin: Points, direction: Points) -> tuple[Points, NDArray[np.bool_]]:
        """Return where rays enter (N,), as multiples of ``direction`` (N, 3), inf for none; whether at the top."""
        ...

    def distance(self, points: Points) -> Points:
        """Return signed distances (N,) of points (N, 3) from the surface, mm, negative inside."""
        ...

    def height(self, x: Points, y: Points) -> Points:
        """Return the height of the upper surface at positions x, y (...), mm; NaN beside the solid."""
        ...

    def corners(self) -> Points:
        """Return the corners (8, 3) of the bounding box."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class BoxSolid:
    """An axis-aligned box."""

    low: Points
    """(3,) mm."""
    high: Points
    """(3,) mm."""

    def intersect(self, origin: Points, direction: Points) -> tuple[Points, NDArray[np.bool_]]:
        """See `ConvexBody`."""
        with np.errstate(divide="ignore", invalid="ignore"):
            one, two = (self.low - origin) / direction, (self.high - origin) / direction
        near, far = np.minimum(one, two), np.maximum(one, two)
        enter, leave = near.max(axis=1), far.min(axis=1)
        return np.where(enter < leave, enter, np.inf), near[:, 2] >= enter

    def distance(self, points: Points) -> Points:
        """See `ConvexBody`."""
        off = np.abs(points - (self.low + self.high) / 2) - (self.high - self.low) / 2
        return np.linalg.norm(np.maximum(off, 0), axis=1) + np.minimum(off.max(axis=1), 0)

    def height(self, x: Points, y: Points) -> Points:
        """See `ConvexBody`."""
        inside = (x >= self.low[0]) & (x <= self.high[0]) & (y >= self.low[1]) & (y <= self.high[1])
        return np.where(inside, self.high[2], np.nan)

    def corners(self) -> Points:
        """See `ConvexBody`."""
        return _bounding_corners(self.low, self.high)


@dataclass(frozen=True, slots=True, eq=False)
class SphereSolid:
    """A sphere."""

    center: Points
    """(3,) mm."""
    radius: float

    def intersect(self, origin: Points, direction: Points) -> tuple[Points, NDArray[np.bool_]]:
        """See `ConvexBody`; the whole sphere counts as the top."""
        enter = _intersect_round(origin - self.center, direction, self.radius)[0]
        return enter, np.ones(len(enter), bool)

    def distance(self, points: Points) -> Points:
        """See `ConvexBody`."""
        return np.linalg.norm(points - self.center, axis=1) - self.radius

    def height(self, x: Points, y: Points) -> Points:
        """See `ConvexBody`."""
        with np.errstate(invalid="ignore"):
            rise = np.sqrt(self.radius**2 - (x - self.center[0]) ** 2 - (y - self.center[1]) ** 2)
        return self.center[2] + rise

    def corners(self) -> Points:
        """See `ConvexBody`."""
        return _bounding_corners(self.center - self.radius, self.center + self.radius)


@dataclass(frozen=True, slots=True, eq=False)
class CylinderSolid:
    """An upright cylinder on z = 0."""

    center: Points
    """(2,) mm."""
    radius: float
    height_mm: float

    def intersect(self, origin: Points, direction: Points) -> tuple[Points, NDArray[np.bool_]]:
        """See `ConvexBody`."""
        side_in, side_out = _intersect_round(origin[:2] - self.center, direction[:, :2], self.radius)
        with np.errstate(divide="ignore", invalid="ignore"):
            bottom, top = -origin[2] / direction[:, 2], (self.height_mm - origin[2]) / direction[:, 2]
        flat = np.minimum(bottom, top)
        enter, leave = np.maximum(side_in, flat), np.minimum(side_out, np.maximum(bottom, top))
        return np.where(enter < leave, enter, np.inf), (flat >= side_in) & (top <= bottom)

    def distance(self, points: Points) -> Points:
        """See `ConvexBody`."""
        beside = np.linalg.norm(points[:, :2] - self.center, axis=1) - self.radius
        above = np.abs(points[:, 2] - self.height_mm / 2) - self.height_mm / 2
        out = np.hypot(np.maximum(beside, 0), np.maximum(above, 0))
        return out + np.minimum(np.maximum(beside, above), 0)

    def height(self, x: Points, y: Points) -> Points:
        """See `ConvexBody`."""
        inside = np.hypot(x - self.center[0], y - self.center[1]) <= self.radius
        return np.where(inside, self.height_mm, np.nan)

    def corners(self) -> Points:
        """See `ConvexBody`."""
        low, high = self.center - self.radius, self.center + self.radius
        return _bounding_corners(np.array([*low, 0.0]), np.array([*high, self.height_mm]))


def build_solids(module: Module) -> tuple[ConvexBody, ...]:
    """Return the base, then the features in the order of `Module.features`."""
    length, width, thickness = module.base.size_mm
    base = BoxSolid(np.array([-length / 2, -width / 2, -thickness]), np.array([length / 2, width / 2, 0.0]))
    return (base, *(_solid(feature) for feature in module.features))


def _solid(feature: Feature) -> ConvexBody:
    center = np.array(feature.center_mm, dtype=np.float64)
    if isinstance(feature, Cube):
        half = feature.edge_mm / 2
        return BoxSolid(np.array([*(center - half), 0.0]), np.array([*(center + half), 2 * half]))
    if isinstance(feature, Sphere):
        return SphereSolid(np.array([*center, feature.diameter_mm / 2]), feature.diameter_mm / 2)
    return CylinderSolid(center, feature.diameter_mm / 2, feature.height_mm)


def _bounding_corners(low: Points, high: Points) -> Points:
    return np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )


def _intersect_round(off: Points, direction: Points, radius: float) -> tuple[Points, Points]:
    """Return both t at which lines off + t·direction are at a distance ``radius`` from zero; inf, −inf for none."""
    a, b = np.sum(direction**2, axis=1), direction @ off
    inner = b * b - a * (off @ off - radius**2)
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(inner)
        return np.where(inner > 0, (-b - root) / a, np.inf), np.where(inner > 0, (-b + root) / a, -np.inf)


NO_PART = -1
"""Label of a pixel that shows no part of the module."""


@dataclass(frozen=True, slots=True, eq=False)
class NominalView:
    """The nearest part of the nominal module at each pixel of the core's undistorted grid."""

    label: NDArray[np.int16]
    """(H, W) 0 the base, i + 1 the i-th feature, NO_PART beside the module."""
    top: NDArray[np.bool_]
    """(H, W) whether the part is an upper face (a whole sphere counts as one)."""
    depth_mm: NDArray[np.float64]
    """(H, W) along the optical axis; NaN beside the module."""

    def face(self, label: int) -> NDArray[np.bool_]:
        """Return the pixels (H, W) of the upper face of one part."""
        return (self.label == label) & self.top


def render_nominal_view(module: Module, core_from_module: Pose, camera: Camera) -> NominalView:
    """Render the module by casting a ray through every pixel that can show it."""
    width, height = camera.size_px
    label = np.full((height, width), NO_PART, np.int16)
    top = np.zeros((height, width), bool)
    depth = np.full((height, width), np.inf)
    module_from_core = core_from_module.inverse()
    for index, solid in enumerate(build_solids(module)):
        window = _project_window(solid, core_from_module, camera)
        if window is None:
            continue
        rays = _compute_rays(camera, window) @ module_from_core.rotation.T
        z, upper = solid.intersect(module_from_core.translation_mm, rays.reshape(-1, 3))
        z, upper = z.reshape(rays.shape[:2]), upper.reshape(rays.shape[:2])
        nearer = (z < depth[window]) & (z > 0)
        depth[window] = np.where(nearer, z, depth[window])
        label[window] = np.where(nearer, index, label[window])
        top[window] = np.where(nearer, upper, top[window])
    depth[label == NO_PART] = np.nan
    return NominalView(label, top, depth)


def _project_window(solid: ConvexBody, core_from_module: Pose, camera: Camera) -> tuple[slice, slice] | None:
    """Return the rows and columns that can show a solid; None if there are none."""
    corners = core_from_module.apply(solid.corners())
    if (corners[:, 2] <= 0).any():
        return None
    pixels = corners[:, :2] / corners[:, 2:] * camera.focal_px + camera.center_px
    low, high = np.floor(pixels.min(axis=0)).astype(int), np.ceil(pixels.max(axis=0)).astype(int) + 1
    low, high = np.maximum(low, 0), np.minimum(high, camera.size_px)
    return None if (low >= high).any() else (slice(low[1], high[1]), slice(low[0], high[0]))


def _compute_rays(camera: Camera, window: tuple[slice, slice]) -> NDArray[np.float64]:
    """Return the rays (h, w, 3) x/z, y/z, 1 of the pixels in a window."""
    v, u = np.mgrid[window]
    x, y = (u - camera.center_px[0]) / camera.focal_px[0], (v - camera.center_px[1]) / camera.focal_px[1]
    return np.stack([x, y, np.ones_like(x)], axis=-1)
