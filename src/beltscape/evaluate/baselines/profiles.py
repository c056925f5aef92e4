"""Triangulation of profiles into a surface, and its depth on the core camera's pinhole grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.simulate.geometry.ray_casting import RayScene
from beltscape.simulate.geometry.world import Label, Solid, Station
from beltscape.simulate.sensors.profile_scan import ProfileScan
from beltscape.simulate.truth.visibility import compute_pixel_rays

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
