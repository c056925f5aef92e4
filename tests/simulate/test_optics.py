"""The simulated lens: distortion, integration over pixels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.simulate.rendering.optics import Lens, Optics, make_pinholes
from tests.synthetic.light import camera


def painted(pinhole, scene):
    """A pinhole's picture of a scene given as a function of x/z, y/z."""
    width, height = pinhole.crop_px[2:]
    origin = np.ravel(pinhole.project(np.zeros(1), np.zeros(1)))
    x = (np.arange(width) - origin[0]) / pinhole.focal_px
    y = (np.arange(height) - origin[1]) / pinhole.focal_px
    light = scene(*np.meshgrid(x, y))
    return np.repeat(np.asarray(light, np.float32)[..., None], 3, axis=-1)


def developed(lens, scene, count=1):
    holes = lens.make_pinholes(count)
    return lens.integrate_pixels(holes, [painted(hole, scene) for hole in holes])[..., 0]


@given(k1=st.floats(-0.2, 0.2), p1=st.floats(-2e-3, 2e-3), p2=st.floats(-2e-3, 2e-3), n=st.integers(1, 4))
def test_ramp_is_imaged_where_the_lens_projects_it(k1, p1, p2, n):
    """A picture that is x/z (or y/z) itself must come back as the camera undistorts its pixels."""
    cam = camera(60, 50, focal=75.0, distortion=(k1, 0.05, p1, p2, 0.0))
    lens = Lens(cam, Optics(psf_sigma_px=0.0 if n == 1 else 0.6), n)
    pixels = np.stack(np.meshgrid(np.arange(60), np.arange(50)), axis=-1)
    true = cam.undistort(pixels)
    for axis, scene in enumerate((lambda x, _: x, lambda _, y: y)):
        error = (developed(lens, scene, count=3) - true[..., axis]) * cam.focal_px[axis]
        # blurring a curved map shifts it by half its variance times its curvature: all that may remain
        assert np.abs(error).max() < 0.01


def test_integration_preserves_light():
    lens = Lens(camera(), Optics(psf_sigma_px=1.7), 3)
    np.testing.assert_allclose(developed(lens, lambda x, _: np.full_like(x, 0.37)), 0.37, rtol=1e-5)


def test_bands_leave_no_seams():
    cam = camera(40, 300, focal=300.0)
    image = developed(Lens(cam, Optics(), 2), lambda _, y: np.sin(40 * y))
    rows = image[:, 20].astype(float)
    jumps = np.abs(np.diff(rows, 3))
    assert jumps[120:135].max() < 1.5 * jumps.max()
    true = np.sin(40 * cam.undistort(np.stack([np.full(300, 20.0), np.arange(300.0)], axis=-1))[:, 1])
    assert np.abs(rows - true).max() < 0.02


@pytest.mark.parametrize("count", [1, 2, 3, 5, 8, 13])
def test_pinholes_interleave_evenly_in_both_directions(count):
    shifts = np.array([hole.shift_px for hole in make_pinholes(camera(), 2, count, 3.0, 0.0, 700.0)])
    even = (np.arange(count) + 0.5) / count - 0.5
    np.testing.assert_allclose(np.sort(shifts[:, 0]), even)
    np.testing.assert_allclose(np.sort(shifts[:, 1]), even)


def test_pinholes_fill_the_aperture_about_its_centre():
    holes = np.array([hole.lens_mm for hole in make_pinholes(camera(), 1, 200, 3.0, 8.0, 700.0)])
    np.testing.assert_allclose(holes.mean(axis=0), 0, atol=1e-9)
    np.testing.assert_allclose(holes.var(axis=0), 4.0**2 / 4, rtol=0.05)
    assert np.linalg.norm(holes, axis=1).max() < 4.05
