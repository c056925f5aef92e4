"""A LiDAR profile scanner vertically above the belt: ranges in a fan across it, profile by profile.

The beam has a width: the range is the mean over rays spread over it, weighted by the returned light, so that a beam
on an edge reports a point in between. Range noise is added. The geometry is of the class of SICK's LMS4000: 70° in
steps of 0.0833° (operating instructions 8023198). Assumed are 600 profiles a second, a range noise of 1 mm, a spot
of 3 mm, and that no surface is too dark.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from beltscape.simulate.geometry.ray_casting import RayScene
from beltscape.simulate.geometry.reflectance import reflectance_at
from beltscape.simulate.geometry.world import World
from beltscape.simulate.sensors.profile_scan import ProfileScan, positions_mm

Length = Annotated[float, Field(gt=0, le=1e5)]


class LidarSettings(BaseModel):
    """The scanner."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    height_mm: Length = 1000.0
    """Height above the belt's level middle; nearer than 700 mm such a scanner does not measure."""
    field_deg: Annotated[float, Field(gt=1, lt=170)] = 70.0
    step_deg: Annotated[float, Field(gt=0.001, le=5)] = 0.0833
    profiles_per_s: Annotated[float, Field(gt=0, le=1e6)] = 600.0
    range_noise_mm: Annotated[float, Field(ge=0, le=1000)] = 1.0
    """Standard deviation."""
    spot_mm: Annotated[float, Field(ge=0, le=100)] = 3.0
    """Edge of the square, uniform beam."""
    rays: Annotated[int, Field(ge=1, le=9)] = 3
    """Rays over the spot, in each direction."""


def scan_lidar(
    world: World,
    settings: LidarSettings,
    *,
    speed_mm_s: float,
    along_mm: tuple[float, float],
    seed: int = 0,
) -> ProfileScan:
    """Scan a world that the belt carries past at a speed; the encoder is assumed to be perfect."""
    scene = RayScene(world.solids)
    half = float(np.deg2rad(settings.field_deg) / 2)
    angles = np.arange(-half, half + 1e-9, float(np.deg2rad(settings.step_deg)))
    directions = np.column_stack([np.sin(angles), np.zeros(len(angles)), -np.cos(angles)])
    across = np.column_stack([np.cos(angles), np.zeros(len(angles)), np.sin(angles)])
    step = speed_mm_s / settings.profiles_per_s
    rng = np.random.default_rng(seed)
    profiles: list[NDArray[np.float64]] = []
    sigmas: list[NDArray[np.float64]] = []
    for y in positions_mm(along_mm, step):
        eye = np.array([0.0, y, settings.height_mm])
        distance = _mean_ranges(scene, world, eye, directions, across, settings)
        distance = distance + rng.normal(scale=settings.range_noise_mm, size=len(angles))
        profiles.append(eye + distance[:, None] * directions)
        sigmas.append(np.where(np.isfinite(distance), settings.range_noise_mm * np.cos(angles), np.nan))
    return ProfileScan(np.stack(profiles), np.stack(sigmas), step)


def _mean_ranges(
    scene: RayScene,
    world: World,
    eye: NDArray[np.float64],
    directions: NDArray[np.float64],
    across: NDArray[np.float64],
    settings: LidarSettings,
) -> NDArray[np.float64]:
    """Return (C,) ranges without noise; NaN where a beam hits nothing."""
    offsets = ((np.arange(settings.rays) + 0.5) / settings.rays - 0.5) * settings.spot_mm
    total, weight = np.zeros(len(directions)), np.zeros(len(directions))
    for right in offsets:
        for ahead in offsets:
            start = eye + right * across + np.array([0.0, ahead, 0.0])
            hits = scene.cast(start, directions)
            is_hit = hits.face >= 0
            points = start + np.where(is_hit, hits.distance, 0.0)[:, None] * directions
            cosine = np.abs((scene.face_normals(hits.face) * directions).sum(axis=1))
            returned = reflectance_at(scene, world.solids, hits.face, points) * cosine
            light = np.where(is_hit, returned / np.maximum(hits.distance, 1.0) ** 2, 0.0)
            total += np.where(is_hit, light * hits.distance, 0.0)
            weight += light
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(weight > 0, total / weight, np.nan)
