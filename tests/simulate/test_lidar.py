"""The simulated LiDAR: ranges with their noise, mixed at edges."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.simulate.profile_scanners import LidarSettings, scan_lidar
from beltscape.simulate.shapes import make_box
from tests.simulate import scenes

WORLD = scenes.world(scenes.load(make_box((100.0, 400.0, 50.0))), lit=False)
COARSE = LidarSettings(step_deg=0.5, range_noise_mm=0.0)


def scan(settings: LidarSettings, seed: int = 0) -> np.ndarray:
    """(P, C, 3)."""
    found = scan_lidar(WORLD, settings, speed_mm_s=1000.0, along_mm=(-30.0, 30.0), seed=seed)
    return found.points_mm


def test_points_lie_on_the_box():
    points = scan(COARSE)
    on_top = np.abs(points[..., 0]) < 45
    np.testing.assert_allclose(points[on_top][:, 2], 50.0, atol=0.01)
    steps = np.diff(points[:, 0, 1])
    np.testing.assert_allclose(steps, 1000 / 600)


def test_noise_lies_along_the_beam_and_repeats_by_seed():
    noisy = COARSE.model_copy(update={"range_noise_mm": 2.0})
    points = scan(noisy, 5)
    on_top = np.abs(points[..., 0]) < 40
    assert points[on_top][:, 2].std() == pytest.approx(2.0, rel=0.1)
    np.testing.assert_array_equal(points, scan(noisy, 5))
    assert (points != scan(noisy, 6)).any()


def test_beam_on_an_edge_reports_a_point_in_between():
    """The box's flanks look away from a scanner above its middle, so that no single ray meets them."""
    assert between(LidarSettings(step_deg=0.05, range_noise_mm=0.0, spot_mm=4.0)) > 0
    assert between(LidarSettings(step_deg=0.05, range_noise_mm=0.0, rays=1)) == 0


def between(settings: LidarSettings) -> int:
    """Points above the flat belt and below the box's top."""
    x, _, height = np.moveaxis(scan(settings), -1, 0)
    return int(((height > 5) & (height < 45) & (np.abs(x) < 100)).sum())
