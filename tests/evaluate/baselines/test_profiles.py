"""Profiles become the surface between their points, and nothing across steps and gaps."""

from __future__ import annotations

import numpy as np

from beltscape.evaluate.line_laser import rasterise_profiles
from beltscape.simulate.profile_scanners import ProfileScan
from tests.simulate import scenes


def scan(height) -> ProfileScan:
    """Profiles every 5 mm of a surface z = height(x, y)."""
    x, y = np.meshgrid(np.arange(-150.0, 151, 5), np.arange(-120.0, 121, 5))
    z = height(x, y)
    return ProfileScan(np.stack([x, y, z], axis=-1), np.where(np.isfinite(z), 0.3, np.nan), 5.0)


def world_points(scan: ProfileScan) -> np.ndarray:
    """(N, 3) where the core's pixels meet the surface."""
    station = scenes.station()
    depth = rasterise_profiles(scan, station)
    points = depth.points_mm(station.rig.core_camera)[depth.measured]
    assert (depth.sigma_mm[depth.measured] == np.float32(0.3)).all()
    return station.core_from_world.inverse().apply(points)


def test_a_leaning_plane_is_itself():
    points = world_points(scan(lambda x, y: 0.2 * x - 0.1 * y))
    assert len(points) > 1500
    np.testing.assert_allclose(points[:, 2], 0.2 * points[:, 0] - 0.1 * points[:, 1], atol=1e-3)


def test_steps_are_not_bridged():
    points = world_points(scan(lambda x, _: np.where(x > 0, 60.0, 0.0)))
    assert (np.minimum(np.abs(points[:, 2]), np.abs(points[:, 2] - 60)) < 1e-3).all()


def test_gaps_are_not_bridged():
    whole, holed = (
        world_points(scan(f)) for f in (lambda x, _: 0 * x, lambda x, _: np.where(x > 0, np.nan, 0))
    )
    assert (holed[:, 0] <= 1e-3).all()
    assert 0.3 * len(whole) < len(holed) < 0.7 * len(whole)


def test_nothing_measured_is_an_empty_map():
    empty = rasterise_profiles(scan(lambda x, _: np.full_like(x, np.nan)), scenes.station())
    assert not empty.measured.any()
