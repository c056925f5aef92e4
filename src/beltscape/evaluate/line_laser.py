"""Laser-line profiler: sub-pixel line centres, their intersection with the laser plane, and the profiles' surface.

The surface through the profiles gives a depth on the core camera's pinhole grid.

The line centre in each column is the centre of gravity of the counts above a threshold around the brightest pixel,
which is as accurate as other common methods for lines of two to three pixels (Naidu & Fisher, A comparative
analysis of algorithms for determining the peak position of a stripe to sub-pixel accuracy, British Machine Vision
Conference 1991, 217-225, doi:10.1007/978-1-4471-1921-0_28).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.arrays import Array
from beltscape.core.depth import DepthMap
from beltscape.simulate.core_truth import compute_pixel_rays
from beltscape.simulate.profile_scanners import Laser, LineImage, ProfileScan
from beltscape.simulate.ray_casting import RayScene
from beltscape.simulate.world import Label, Solid, Station

_SECOND_PEAK = 0.5
"""Height of a second peak, over the highest one, from which a column is ambiguous; chosen."""


class PeakSettings(BaseModel):
    """Detection of the laser line."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    least: Annotated[float, Field(ge=1, le=255)] = 12.0
    """Smallest counts of its brightest pixel."""
    window_px: Annotated[int, Field(ge=1, le=50)] = 4
    """Rows on each side of it that are evaluated."""
    base: Annotated[float, Field(ge=0, lt=1)] = 0.1
    """Share of the brightest pixel's counts below which a pixel has no weight."""
    brightest: Annotated[int, Field(ge=1, le=255)] = 254
    """Largest counts of its brightest pixel; above lies saturation."""
    read_noise: Annotated[float, Field(ge=0, le=100)] = 0.4
    """Read noise of the camera, counts."""
    electrons_per_count: Annotated[float, Field(gt=0, le=1e6)] = 55.0
    """Electrons per count: a full well of 14,000 over 255 counts."""


def locate_line_centers(
    image: NDArray[np.uint8], settings: PeakSettings | None = None
) -> tuple[Array, Array]:
    """Return the rows (W,) of the line centre in an image (h, W) and their σ (W,) by camera noise; NaN: no line.

    A column with a second peak of `_SECOND_PEAK` of the height outside the window is ambiguous and gives NaN.
    """
    settings = settings or PeakSettings()
    counts = image.astype(np.float64)
    rows = np.arange(len(counts))[:, None]
    top, peak = counts.argmax(axis=0), counts.max(axis=0)
    near = np.abs(rows - top) <= settings.window_px
    second = np.where(near, 0, counts).max(axis=0)
    weight = np.where(near, np.maximum(counts - settings.base * peak, 0), 0)
    total = weight.sum(axis=0)
    good = (peak >= settings.least) & (second < _SECOND_PEAK * peak) & (peak <= settings.brightest)
    with np.errstate(invalid="ignore", divide="ignore"):
        middle = (rows * weight).sum(axis=0) / total
        variance = settings.read_noise**2 + counts / settings.electrons_per_count
        spread = np.where(weight > 0, (rows - middle) ** 2 * variance, 0).sum(axis=0)
        sigma = np.sqrt(spread) / total
    return np.where(good, middle, np.nan), np.where(good, sigma, np.nan)


def measure_profiles(
    images: Iterable[LineImage],
    station: Station,
    laser: Laser,
    step_mm: float,
    *,
    speckle_px: float = 0.0,
    settings: PeakSettings | None = None,
) -> ProfileScan:
    """Return the profiles from the line's images; camera and laser plane are calibrated.

    ``speckle_px`` is the contribution of laser speckle to σ.
    """
    camera, world_from_core = station.rig.core_camera, station.core_from_world.inverse()
    columns = np.arange(camera.size_px[0], dtype=np.float64)
    points: list[Array] = []
    sigmas: list[Array] = []
    for one in images:
        middle, sigma_px = locate_line_centers(one.image, settings)
        row = middle + one.first_row + one.drift_px
        met = [
            _intersect_laser_plane(columns, row + off, station, laser, world_from_core.rotation)
            for off in (0.0, 0.5)
        ]
        per_px = 2 * np.abs(met[1][:, 2] - met[0][:, 2])
        points.append(met[0] + [0.0, one.along_mm, 0.0])
        sigmas.append(per_px * np.hypot(sigma_px, speckle_px))
    return ProfileScan(np.stack(points), np.stack(sigmas), step_mm)


def _intersect_laser_plane(
    columns: Array, rows: Array, station: Station, laser: Laser, world_from_core: Array
) -> Array:
    """Return where distorted pixels' rays meet the laser plane, (W, 3) in the world at belt position 0."""
    ideal = station.rig.core_camera.undistort(np.column_stack([columns, rows]))
    rays = np.column_stack([ideal, np.ones(len(ideal))]) @ world_from_core.T
    eye = station.core_from_world.center_mm
    with np.errstate(invalid="ignore", divide="ignore"):
        far = ((laser.eye_mm - eye) @ laser.normal) / (rays @ laser.normal)
    return eye + far[:, None] * rays


REACH = 3.0
"""Neighbours farther apart than this multiple of the median distance are not joined (a step or a gap); chosen."""


def rasterise_profiles(scan: ProfileScan, station: Station) -> DepthMap:
    """Return the core camera's depth of the surface through the points of neighbouring profiles.

    Steps and gaps are not bridged. A pixel's σ is that of the nearest corner of its triangle.
    """
    camera, pose = station.rig.core_camera, station.core_from_world
    height, width = camera.size_px[1], camera.size_px[0]
    faces = _faces(scan)
    empty = np.full((height, width), np.nan, np.float32)
    if not len(faces):
        zeros = np.zeros((height, width))
        return DepthMap(empty, empty, zeros.astype(np.uint8), zeros.astype(np.float32))
    vertices, sigma = np.nan_to_num(scan.points_mm.reshape(-1, 3)), scan.sigma_mm.ravel()
    surface = Solid("profiles", Label.MATERIAL, vertices, faces, (1.0, 1.0, 1.0))
    rays = compute_pixel_rays(camera, pose, distorted=False)
    hits = RayScene([surface]).cast(pose.center_mm, rays)
    hit = hits.face >= 0
    depth = np.where(hit, hits.distance, np.nan)
    at = pose.center_mm + np.where(hit, depth, 0.0)[:, None] * rays
    corners = faces[np.where(hit, hits.face, 0)]
    away = np.linalg.norm(vertices[corners] - at[:, None], axis=-1)
    nearest = np.take_along_axis(corners, away.argmin(axis=1)[:, None], axis=1)[:, 0]
    found = np.where(hit, sigma[nearest], np.nan)
    return DepthMap(
        depth.reshape(height, width).astype(np.float32),
        found.reshape(height, width).astype(np.float32),
        hit.reshape(height, width).astype(np.uint8),
        hit.reshape(height, width).astype(np.float32),
    )


def _faces(scan: ProfileScan) -> NDArray[np.int64]:
    """Return the triangles (F, 3), two per four close neighbours, counter-clockwise seen from above."""
    profiles, columns = scan.points_mm.shape[:2]
    index = np.arange(int(profiles * columns)).reshape(profiles, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.concatenate([np.stack(f, axis=-1).reshape(-1, 3) for f in ((a, b, c), (b, d, c))])
    corners = scan.points_mm.reshape(-1, 3)[faces]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).max(axis=1)
    usual = np.nanmedian(edges) if np.isfinite(edges).any() else 0.0
    return faces[edges <= REACH * usual]
