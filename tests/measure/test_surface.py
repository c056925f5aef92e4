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


def test_the_sampling_of_a_large_image_is_that_of_all_its_pixels() -> None:
    """A part of the pixels gives the medians; what is beside the measured ones does not change them."""
    scene = Scene(FLAT)
    whole = depth_map(scene.depth_mm())
    assert min(whole.depth_mm.shape) >= 200
    rng = np.random.default_rng(1)
    sigma = rng.uniform(0.5, 1.5, whole.depth_mm.shape).astype(np.float32)
    z = np.where(rng.random(sigma.shape) < 0.7, whole.depth_mm, np.nan).astype(np.float32)
    found = compute_sampling(DepthMap(z, sigma, whole.views, whole.confidence), scene.camera)
    distance, noise = (float(np.median(values[np.isfinite(z)])) for values in (z, sigma))
    pixel = distance / float(scene.camera.focal_px.mean())
    assert abs(found.pixel_mm / pixel - 1) < 1e-3
    assert abs(found.step_mm / (pixel / np.tan(np.deg2rad(10)) + 6 * noise) - 1) < 0.02


def test_single_measured_pixels_of_a_large_image_have_a_sampling() -> None:
    """Where the sample holds none of them, it is theirs."""
    scene = Scene(FLAT)
    whole = depth_map(scene.depth_mm())
    z = np.full(whole.depth_mm.shape, np.nan, np.float32)
    z[100:102, 100:102] = whole.depth_mm[100:102, 100:102]  # no multiple of three
    found = compute_sampling(DepthMap(z, whole.sigma_mm, whole.views, whole.confidence), scene.camera)
    distance = float(np.nanmedian(z))
    assert found.pixel_mm == distance / float(scene.camera.focal_px.mean())


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
