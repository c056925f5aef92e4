"""Coverage of the belt: the number of cameras at each position, the pixel size, and the length of belt in a frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from beltscape.plan.footprint import Polygon, area_mm2, clip, clip_to_strip, overlap_shares, project_footprint
from beltscape.plan.planned_rig import PlannedRig
from beltscape.plan.precision import projection_jacobian
from beltscape.plan.settings import PlanSettings

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
    lengths = tuple(_find_length(planned, height_mm, width_mm, number) for number in range(len(others) + 1))
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


def _find_length(planned: PlannedRig, height_mm: float, width_mm: float, auxiliaries: int) -> float:
    """Return twice the largest |y| up to which the core and n auxiliaries see the whole width."""
    across = np.linspace(-width_mm / 2, width_mm / 2, _POINTS_ACROSS)

    def is_whole_width_seen(y: float) -> bool:
        points = np.array([[x, side * y, height_mm] for side in (-1, 1) for x in across])
        seen = sum(planned.sees(name, points).astype(int) for name in planned.rig.auxiliaries)
        return bool((planned.sees(planned.rig.core, points) & (seen >= auxiliaries)).all())

    if not is_whole_width_seen(0.0):
        return 0.0
    low, high = 0.0, float(np.abs(project_footprint(planned, planned.rig.core, height_mm)[:, 1]).max()) + 1
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        low, high = (middle, high) if is_whole_width_seen(middle) else (low, middle)
    return 2 * low


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
