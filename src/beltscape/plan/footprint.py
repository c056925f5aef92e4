"""Footprints: the exact projection of a camera's image border on a level plane, and overlaps of several."""

from __future__ import annotations

from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError
from beltscape.plan.planned_rig import PlannedRig

Polygon = NDArray[np.float64]
"""(n, 2) corners x, y in the world, mm, anticlockwise seen from above; (0, 2): empty."""


def project_footprint(planned: PlannedRig, name: str, height_mm: float) -> Polygon:
    """Return (4, 2) the outer border of a camera's image on the plane z = height, or raise InputError."""
    camera, pose = planned.rig.cameras[name], planned.cam_from_world(name)
    width, height = camera.size_px
    corners = np.array([[0, 0], [0, height], [width, height], [width, 0]]) - 0.5
    rays = np.column_stack([camera.undistort(corners), np.ones(4)]) @ pose.rotation
    center = pose.center_mm
    if (rays[:, 2] >= -1e-3).any():
        raise InputError(
            f"baseline_mm = {planned.baseline_mm:g}: {name} would be tilted by "
            f"{np.rad2deg(planned.tilt_rad):.1f}° and "
            "see past the belt to the horizon; give a shorter baseline or a longer lens"
        )
    points = center + rays * ((height_mm - center[2]) / rays[:, 2])[:, None]
    return orient_anticlockwise(points[:, :2])


def clip_to_strip(width_mm: float, polygon: Polygon) -> Polygon:
    """Return the part of a polygon within ``width_mm`` across the belt."""
    reach = float(np.abs(polygon).max(initial=0)) + 1
    half = width_mm / 2
    return clip(polygon, np.array([[-half, -reach], [half, -reach], [half, reach], [-half, reach]]))


def orient_anticlockwise(polygon: Polygon) -> Polygon:
    """Return the corners in anticlockwise order."""
    x, y = polygon.T
    signed_area = np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)
    return polygon if signed_area > 0 else polygon[::-1].copy()


def area_mm2(polygon: Polygon) -> float:
    """Return the area of a polygon."""
    if len(polygon) < 3:
        return 0.0
    x, y = (polygon - polygon[0]).T
    return float(abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2)


def clip(subject: Polygon, window: Polygon) -> Polygon:
    """Return the intersection of two convex polygons (Sutherland & Hodgman 1974, doi:10.1145/360767.360802)."""
    result = subject
    for start, end in zip(window, np.roll(window, -1, axis=0), strict=True):
        if not len(result):
            break
        edge = end - start
        inside = edge[0] * (result[:, 1] - start[1]) - edge[1] * (result[:, 0] - start[0])
        corners: list[NDArray[np.float64]] = []
        for i in range(len(result)):
            a, b = inside[i], inside[(i + 1) % len(result)]
            if a >= 0:
                corners.append(result[i])
            if (a > 0 > b) or (a < 0 < b):
                corners.append(result[i] + a / (a - b) * (result[(i + 1) % len(result)] - result[i]))
        result = np.array(corners).reshape(-1, 2)
    return result


def overlap_shares(base: Polygon, others: list[Polygon]) -> tuple[float, ...]:
    """Return the exact share of ``base`` that at least 0, 1, …, n of the other convex polygons cover.

    By inclusion–exclusion over all subsets: with S_j the sum of the areas of all intersections of j of them,
    exactly m cover Σ_{j≥m} (−1)^(j−m) C(j, m) S_j.
    """
    whole, count = area_mm2(base), len(others)
    if whole == 0:
        return (0.0,) * (count + 1)
    sums = [0.0] * (count + 1)
    for size in range(count + 1):
        for chosen in combinations(others, size):
            piece = base
            for other in chosen:
                piece = clip(piece, other)
            sums[size] += area_mm2(piece)
    exactly = [
        sum((-1) ** (j - m) * comb(j, m) * sums[j] for j in range(m, count + 1)) for m in range(count + 1)
    ]
    at_least = np.cumsum(exactly[::-1])[::-1] / whole
    return tuple(float(share) for share in np.clip(at_least, 0, 1))
