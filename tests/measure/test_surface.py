"""Height maps of a depth map, and the selection of reliable pixels."""

from __future__ import annotations

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.measure.belt.empty_belt import find_belt
from beltscape.measure.surface import Grid, compute_height_map, compute_sampling, reliable_mask
from tests.measure.belt_scenes import Ball, Scene, depth_map, trough

FLAT = trough(900)


def surface_of(scene: Scene, depth: DepthMap):
    belt = find_belt(depth_map(Scene(FLAT).depth_mm()), scene.camera)
    sampling = compute_sampling(depth, scene.camera)
    grid = Grid.over((-150.0, 150.0), (-150.0, 150.0), sampling.pixel_mm)
    return compute_height_map(depth, scene.camera, belt.belt_from_core, grid, depth.measured, sampling), grid


def test_heights_of_a_ball() -> None:
    scene = Scene(FLAT, (Ball((0.0, 0.0, 0.0), 100.0),))
    surface, grid = surface_of(scene, depth_map(scene.depth_mm()))
    x, y = np.meshgrid(grid.x_mm, grid.y_mm)
    inside = np.hypot(x, y) < 70
    true = np.sqrt(np.clip(100**2 - x**2 - y**2, 0, None))
    error = (surface.heights.height_mm - true)[inside]
    assert np.nanmax(np.abs(error)) < 1.5
    assert abs(np.nanmean(error)) < 0.05


def test_an_overhang_counts_as_solid() -> None:
    # a ball in the air: beyond its equator the camera, beside it, sees the belt beneath
    scene = Scene(FLAT, (Ball((100.0, 0.0, 120.0), 40.0),))
    surface, grid = surface_of(scene, depth_map(scene.depth_mm()))
    x, y = np.meshgrid(grid.x_mm, grid.y_mm)
    under = np.hypot(x - 100, y) < 36
    height = surface.heights.height_mm[under]
    assert np.nanmin(height) > 100
    assert np.isfinite(height).mean() > 0.9


def test_trust_leaves_out_flying_unconfirmed_and_doubtful_pixels() -> None:
    depth = depth_map(Scene(FLAT).depth_mm())
    sigma, views, z = depth.sigma_mm.copy(), depth.views.copy(), depth.depth_mm.copy()
    z[50, 60] -= 80
    views[100:110, 100:110] = 1
    sigma[150:160, 200:210] = 9
    found = reliable_mask(DepthMap(z, sigma, views, depth.confidence), 2.5, 14.0, 5.0)
    assert not found[50, 60]
    assert not found[100:110, 100:110].any()
    assert not found[150:160, 200:210].any()
    assert found.mean() > 0.99


def test_trust_keeps_one_view_where_one_is_all_there_is() -> None:
    depth = depth_map(Scene(FLAT).depth_mm())
    binocular = DepthMap(depth.depth_mm, depth.sigma_mm, np.ones_like(depth.views), depth.confidence)
    assert reliable_mask(binocular, 2.5, 14.0, 5.0).all()
