"""Boxes, spheres and upright cylinders of a module: ray intersection, signed distance, and height."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from beltscape.target.module import Cube, Feature, Module, Sphere

Points = NDArray[np.float64]


class Solid(Protocol):
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
        """See `Solid`."""
        with np.errstate(divide="ignore", invalid="ignore"):
            one, two = (self.low - origin) / direction, (self.high - origin) / direction
        near, far = np.minimum(one, two), np.maximum(one, two)
        enter, leave = near.max(axis=1), far.min(axis=1)
        return np.where(enter < leave, enter, np.inf), near[:, 2] >= enter

    def distance(self, points: Points) -> Points:
        """See `Solid`."""
        off = np.abs(points - (self.low + self.high) / 2) - (self.high - self.low) / 2
        return np.linalg.norm(np.maximum(off, 0), axis=1) + np.minimum(off.max(axis=1), 0)

    def height(self, x: Points, y: Points) -> Points:
        """See `Solid`."""
        inside = (x >= self.low[0]) & (x <= self.high[0]) & (y >= self.low[1]) & (y <= self.high[1])
        return np.where(inside, self.high[2], np.nan)

    def corners(self) -> Points:
        """See `Solid`."""
        return _bounding_corners(self.low, self.high)


@dataclass(frozen=True, slots=True, eq=False)
class SphereSolid:
    """A sphere."""

    center: Points
    """(3,) mm."""
    radius: float

    def intersect(self, origin: Points, direction: Points) -> tuple[Points, NDArray[np.bool_]]:
        """See `Solid`; the whole sphere counts as the top."""
        enter = _intersect_round(origin - self.center, direction, self.radius)[0]
        return enter, np.ones(len(enter), bool)

    def distance(self, points: Points) -> Points:
        """See `Solid`."""
        return np.linalg.norm(points - self.center, axis=1) - self.radius

    def height(self, x: Points, y: Points) -> Points:
        """See `Solid`."""
        with np.errstate(invalid="ignore"):
            rise = np.sqrt(self.radius**2 - (x - self.center[0]) ** 2 - (y - self.center[1]) ** 2)
        return self.center[2] + rise

    def corners(self) -> Points:
        """See `Solid`."""
        return _bounding_corners(self.center - self.radius, self.center + self.radius)


@dataclass(frozen=True, slots=True, eq=False)
class CylinderSolid:
    """An upright cylinder on z = 0."""

    center: Points
    """(2,) mm."""
    radius: float
    height_mm: float

    def intersect(self, origin: Points, direction: Points) -> tuple[Points, NDArray[np.bool_]]:
        """See `Solid`."""
        side_in, side_out = _intersect_round(origin[:2] - self.center, direction[:, :2], self.radius)
        with np.errstate(divide="ignore", invalid="ignore"):
            bottom, top = -origin[2] / direction[:, 2], (self.height_mm - origin[2]) / direction[:, 2]
        flat = np.minimum(bottom, top)
        enter, leave = np.maximum(side_in, flat), np.minimum(side_out, np.maximum(bottom, top))
        return np.where(enter < leave, enter, np.inf), (flat >= side_in) & (top <= bottom)

    def distance(self, points: Points) -> Points:
        """See `Solid`."""
        beside = np.linalg.norm(points[:, :2] - self.center, axis=1) - self.radius
        above = np.abs(points[:, 2] - self.height_mm / 2) - self.height_mm / 2
        out = np.hypot(np.maximum(beside, 0), np.maximum(above, 0))
        return out + np.minimum(np.maximum(beside, above), 0)

    def height(self, x: Points, y: Points) -> Points:
        """See `Solid`."""
        inside = np.hypot(x - self.center[0], y - self.center[1]) <= self.radius
        return np.where(inside, self.height_mm, np.nan)

    def corners(self) -> Points:
        """See `Solid`."""
        low, high = self.center - self.radius, self.center + self.radius
        return _bounding_corners(np.array([*low, 0.0]), np.array([*high, self.height_mm]))


def build_solids(module: Module) -> tuple[Solid, ...]:
    """Return the base, then the features in the order of `Module.features`."""
    length, width, thickness = module.base.size_mm
    base = BoxSolid(np.array([-length / 2, -width / 2, -thickness]), np.array([length / 2, width / 2, 0.0]))
    return (base, *(_solid(feature) for feature in module.features))


def _solid(feature: Feature) -> Solid:
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
