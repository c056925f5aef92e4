"""Line centres are sub-pixel accurate, and profiles of a simulated laser lie on the surface."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtr

from beltscape.evaluate.line_laser import locate_line_centers, measure_profiles, rasterise_profiles
from beltscape.simulate.core_truth import trace_core_view
from beltscape.simulate.profile_scanners import (
    LaserSettings,
    make_laser,
    render_line_images,
    speckle_sigma_px,
)
from beltscape.simulate.rendering.sensor import Sensor
from beltscape.simulate.shapes import make_box
from tests.simulate import scenes


def line(middle: float, sigma: float = 0.9, height: float = 200.0, rows: int = 40) -> np.ndarray:
    """(h,) a Gaussian line gathered by pixels, in whole counts."""
    edges = np.arange(rows + 1) - 0.5
    counts = np.diff(ndtr((edges - middle) / sigma))
    return np.rint(height * counts / counts.max()).astype(np.uint8)


@given(middle=st.floats(8, 31), sigma=st.floats(0.7, 1.5), height=st.floats(60, 250))
def test_middles_are_sub_pixel(middle: float, sigma: float, height: float):
    found, _ = locate_line_centers(line(middle, sigma, height)[:, None])
    assert found[0] == pytest.approx(middle, abs=0.08)


def test_dark_saturated_and_double_lines_are_none():
    double = np.maximum(line(10.0), line(30.0, height=150.0))
    saturated = np.minimum(line(20.0).astype(int) * 2, 255).astype(np.uint8)
    image = np.column_stack([line(20.0, height=5), saturated, double, line(20.0)])
    found, sigma = locate_line_centers(image)
    assert np.isnan(found[:3]).all()
    assert np.isfinite([found[3], sigma[3]]).all()


def test_sigma_equals_the_scatter_by_noise():
    rng = np.random.default_rng(1)
    clean = np.repeat(line(20.3, height=120.0)[:, None], 4000, axis=1).astype(float)
    noise = rng.normal(size=clean.shape) * np.sqrt(0.4**2 + clean / 55)
    found, sigma = locate_line_centers(np.rint(np.clip(clean + noise, 0, 255)).astype(np.uint8))
    assert found.std() == pytest.approx(np.median(sigma), rel=0.35)


def test_profiles_lie_on_the_surface_and_leave_its_shadow_out():
    station = scenes.station()
    world = scenes.world(scenes.load(make_box((120.0, 100.0, 60.0))), lit=False)
    settings = LaserSettings(step_mm=4.0, speckle_contrast=0.0, rays_per_px=4)
    laser = make_laser(settings, 740.0)
    images = list(
        render_line_images(world, station, laser, settings, Sensor(), along_mm=(-160, 160), blur_px=0.6)
    )
    scan = measure_profiles(images, station, laser, settings.step_mm)
    depth = rasterise_profiles(scan, station)
    view = trace_core_view(world, station)
    top = (view.label == 2) & depth.measured
    error = np.abs(depth.depth_mm - view.depth_mm)
    assert top.sum() > 100
    assert np.median(error[top]) < 0.5  # of pixels of 5 mm
    assert not depth.measured.all()


def test_speckle_is_as_small_as_the_aperture_is_large():
    camera = scenes.station().rig.core_camera
    small, large = (speckle_sigma_px(LaserSettings(aperture_mm=a), camera, 740.0) for a in (1.0, 4.0))
    assert small == pytest.approx(4 * large)
    assert speckle_sigma_px(LaserSettings(speckle_contrast=0.0), camera, 740.0) == 0
