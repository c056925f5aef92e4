"""Time-of-flight frames of a world, by rays cast through every sub-pixel."""

from __future__ import annotations

import numpy as np

from beltscape.core.geometry.pose import Pose
from beltscape.simulate.geometry.ray_casting import RayScene
from beltscape.simulate.geometry.world import World
from beltscape.simulate.time_of_flight.camera import (
    TofFrame,
    TofTruth,
    compute_subpixel_rays,
    simulate_tof_frame,
)
from beltscape.simulate.time_of_flight.settings import TofSettings


def render_tof(
    world: World,
    tof_from_world: Pose,
    settings: TofSettings | None = None,
    *,
    seed: int = 0,
    samples: int = 3,
) -> TofFrame:
    """Return the frame of a camera at a pose; only its own light acts, projector and textures are ignored."""
    chosen = settings or TofSettings()
    return simulate_tof_frame(trace_tof_truth(world, tof_from_world, chosen, samples), chosen, seed)


def trace_tof_truth(world: World, tof_from_world: Pose, settings: TofSettings, samples: int) -> TofTruth:
    """Return depth, albedo (the mean of a solid's red, green and blue) and cosine for samples² rays per pixel."""
    rays = compute_subpixel_rays(settings, samples)
    along = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1).reshape(-1, 3)
    directions = along @ tof_from_world.rotation
    scene = RayScene(world.solids)
    hits = scene.cast(tof_from_world.center_mm, directions)
    is_hit = hits.face >= 0
    normals = scene.face_normals(np.where(is_hit, hits.face, 0))
    cosine = np.abs((normals * directions).sum(axis=1)) / np.linalg.norm(directions, axis=1)
    solid_albedo = np.array([float(np.mean(solid.reflectance)) for solid in world.solids])
    albedo = solid_albedo[np.where(is_hit, scene.solid_of_face[hits.face], 0)]
    shape = rays.shape[:2]
    return TofTruth(  # the rays have z = 1, so that a distance in lengths of a ray is a depth
        np.where(is_hit, hits.distance, np.nan).reshape(shape),
        np.where(is_hit, albedo, 0).reshape(shape),
        np.where(is_hit, cosine, 0).reshape(shape),
    )
