"""Coverage of the belt: the number of cameras at each position, the pixel size, and the length of belt in a frame.

Footprints are the exact projection of a camera's image border on a level plane; several of them overlap.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError
from beltscape.plan.planned_rig import PlannedRig, projection_jacobian
from beltscape.plan.settings import PlanSettings

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
    next_x, next_y = (np.concatenate([each[1:], each[:1]]) for each in (x, y))
    return float(abs(np.sum(x * next_y - next_x * y)) / 2)


def clip(subject: Polygon, window: Polygon) -> Polygon:
    """Return the intersection of two convex polygons (Sutherland & Hodgman 1974, doi:10.1145/360767.360802)."""
    result: list[list[float]] = subject.tolist()  # numbers of Python, the fastest for a handful of corners
    border: list[list[float]] = window.tolist()
    for start, end in zip(border, border[1:] + border[:1], strict=True):
        across, along = end[0] - start[0], end[1] - start[1]
        inside = [across * (y - start[1]) - along * (x - start[0]) for x, y in result]
        corners: list[list[float]] = []
        for i, (x, y) in enumerate(result):
            following = (i + 1) % len(result)
            a, b = inside[i], inside[following]
            if a >= 0:
                corners.append([x, y])
            if (a > 0 > b) or (a < 0 < b):
                share, (next_x, next_y) = a / (a - b), result[following]
                corners.append([x + share * (next_x - x), y + share * (next_y - y)])
        result = corners
    return np.array(result, np.float64).reshape(-1, 2)


def overlap_shares(base: Polygon, others: list[Polygon]) -> tuple[float, ...]:
    """Return the exact share of ``base`` that at least 0, 1, …, n of the other convex polygons cover.

    By inclusion–exclusion over all subsets: with S_j the sum of the areas of all intersections of j of them,
    exactly m cover Σ_{j≥m} (−1)^(j−m) C(j, m) S_j.
    """
    whole, count = area_mm2(base), len(others)
    if whole == 0:
        return (0.0,) * (count + 1)
    sums = [whole] + [0.0] * count
    pieces: dict[tuple[int, ...], Polygon] = {(): base}
    for size in range(1, count + 1):
        for chosen in combinations(range(count), size):
            pieces[chosen] = clip(pieces[chosen[:-1]], others[chosen[-1]])
            sums[size] += area_mm2(pieces[chosen])
    exactly = [
        sum((-1) ** (j - m) * comb(j, m) * sums[j] for j in range(m, count + 1)) for m in range(count + 1)
    ]
    at_least = np.cumsum(exactly[::-1])[::-1] / whole
    return tuple(float(share) for share in np.clip(at_least, 0, 1))


_POINTS_ACROSS = 81
"""Points across the belt at which it must be seen; footprints are convex, so the ends nearly suffice."""
_BISECTIONS = 24
"""Halvings of the searched length: metres to less than a micrometre."""
_PIXEL_SAMPLES = 25
"""Points along each side of the strip's box at which the pixel size is computed; it is smooth between them."""


@dataclass(frozen=True, slots=True, eq=False)
class PlaneCoverage:
    """Coverage of one level plane above the belt."""

    name: str
    height_mm: float
    width_mm: float
    """Width that must be seen."""
    polygons: Mapping[str, Polygon]
    """Border of each camera's image on the plane."""
    all_cameras: Polygon
    """The area seen by every camera."""
    at_least: tuple[float, ...]
    """Share of the strip seen by the core that at least 0, 1, …, n auxiliaries see too."""
    overlap: Mapping[str, float]
    """Share of that strip that each auxiliary sees."""
    core_length_mm: float
    """Length along the belt over which the core sees the full width."""
    lengths_mm: tuple[float, ...]
    """Length over which the core and at least 0, 1, …, n auxiliaries see the full width."""
    pixel_mm: Mapping[str, tuple[float, float, float]]
    """Finest, median and coarsest pixel of each camera over the strip, as the edge of a square of equal area."""


def compute_plane_coverage(
    planned: PlannedRig, name: str, height_mm: float, width_mm: float
) -> PlaneCoverage:
    """Return the coverage of one plane."""
    rig = planned.rig
    polygons = {camera: project_footprint(planned, camera, height_mm) for camera in rig.cameras}
    base = clip_to_strip(width_mm, polygons[rig.core])
    others = [polygons[camera] for camera in rig.auxiliaries]
    common = polygons[rig.core]
    for other in others:
        common = clip(common, other)
    whole = area_mm2(base)
    lengths = _find_lengths(planned, height_mm, width_mm)
    return PlaneCoverage(
        name=name,
        height_mm=height_mm,
        width_mm=width_mm,
        polygons=polygons,
        all_cameras=common,
        at_least=overlap_shares(base, others),
        overlap={c: area_mm2(clip(base, polygons[c])) / whole for c in rig.auxiliaries},
        core_length_mm=lengths[0],
        lengths_mm=lengths,
        pixel_mm={camera: _pixel_mm(planned, camera, height_mm, base) for camera in rig.cameras},
    )


def compute_coverage(settings: PlanSettings, planned: PlannedRig) -> tuple[PlaneCoverage, ...]:
    """Return the coverage of the belt's level middle, its edges and the top of the load."""
    names = ("belt", "edges", "top")
    return tuple(
        compute_plane_coverage(planned, name, height, width)
        for name, (height, width) in zip(names, settings.belt.planes, strict=True)
    )


def usable_length_mm(planes: tuple[PlaneCoverage, ...], auxiliaries: int) -> float:
    """Return the length of belt that a frame covers at full width and every height, by core and n auxiliaries."""
    return min(plane.lengths_mm[auxiliaries] for plane in planes)


def _find_lengths(planned: PlannedRig, height_mm: float, width_mm: float) -> tuple[float, ...]:
    """Return twice the largest |y| up to which the core and at least 0, 1, …, n auxiliaries see the whole width."""
    across = np.linspace(-width_mm / 2, width_mm / 2, _POINTS_ACROSS)
    points = np.array([[x, side, height_mm] for side in (-1.0, 1.0) for x in across])

    @cache
    def count_seeing(y: float) -> int:
        """Return the number of auxiliaries that see the whole width at ±y, point by point; −1 without the core."""
        at_y = points * np.array([1.0, y, 1.0])
        if not planned.sees(planned.rig.core, at_y).all():
            return -1
        return int(np.sum([planned.sees(name, at_y) for name in planned.rig.auxiliaries], axis=0).min())

    longest = float(np.abs(project_footprint(planned, planned.rig.core, height_mm)[:, 1]).max()) + 1

    def find_length(auxiliaries: int) -> float:
        if count_seeing(0.0) < auxiliaries:
            return 0.0
        low, high = 0.0, longest
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            low, high = (middle, high) if count_seeing(middle) >= auxiliaries else (low, middle)
        return 2 * low

    return tuple(find_length(number) for number in range(len(planned.rig.auxiliaries) + 1))


def _pixel_mm(planned: PlannedRig, name: str, height_mm: float, base: Polygon) -> tuple[float, float, float]:
    """Return the finest, median, coarsest pixel over the strip's box, where the camera sees it; NaN if nowhere."""
    low, high = base.min(axis=0), base.max(axis=0)
    columns, rows = (np.linspace(float(low[i]), float(high[i]), _PIXEL_SAMPLES) for i in (0, 1))
    x, y = np.meshgrid(columns, rows)
    points = np.stack([x, y, np.full_like(x, height_mm)], axis=-1).reshape(-1, 3)
    points = points[planned.sees(name, points)]
    if not len(points):
        return float("nan"), float("nan"), float("nan")
    slope = projection_jacobian(planned.rig.cameras[name], planned.cam_from_world(name), points)[:, :, :2]
    edge = 1 / np.sqrt(np.abs(np.linalg.det(slope)))
    return float(edge.min()), float(np.median(edge)), float(edge.max())
