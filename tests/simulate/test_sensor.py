"""The simulated sensor: noise, saturation, gamma and black level."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.simulate.rendering.sensor import Sensor, expose, make_noise_seed

QUIET = {"shot_noise": False, "read_noise_e": 0.0, "electrons_at_1": 10_000.0, "full_well_e": 10_000.0}


def flat(value, shape=(200, 200)):
    return np.full((*shape, 3), value, np.float32)


def test_defaults_give_the_documented_noise():
    image = expose(flat(0.5 * 14 / 12), Sensor(), 7)
    assert image.mean() == pytest.approx(127.5, abs=0.1)
    assert image.std() == pytest.approx(1.5, abs=0.1)


@given(mean_e=st.floats(50, 9000), read_e=st.floats(1, 100), gain=st.floats(0.5, 1.0))
def test_noise_is_shot_noise_and_read_noise(mean_e, read_e, gain):
    sensor = Sensor(
        bits=16, electrons_at_1=1000, full_well_e=20_000, read_noise_e=read_e, gain=gain, black_level=0.1
    )
    image = expose(flat(mean_e / 1000, (100, 100)), sensor, 3).astype(float)
    dn_per_e = 65535 * 0.9 * gain / 20_000
    assert image.mean() == pytest.approx(6553.5 + mean_e * dn_per_e, abs=5 * image.std() / 100)
    assert image.var() == pytest.approx((mean_e + read_e**2) * dn_per_e**2, rel=0.08)


@pytest.mark.parametrize(
    ("bits", "top", "kind"), [(8, 255, np.uint8), (12, 4095, np.uint16), (16, 65535, np.uint16)]
)
def test_saturation_gives_the_largest_value(bits, top, kind):
    image = expose(flat(3.0, (4, 4)), Sensor(bits=bits, **QUIET), 0)
    assert image.dtype == kind
    assert (image == top).all()


def test_small_gain_saturates_below_the_largest_value():
    assert (expose(flat(3.0, (4, 4)), Sensor(gain=0.5, **QUIET), 0) == 128).all()


def test_gamma_and_black_level():
    sensor = Sensor(bits=16, gamma=2.2, black_level=0.05, **QUIET)
    assert (expose(flat(0.3, (2, 2)), sensor, 0) == round(65535 * (0.05 + 0.95 * 0.3) ** (1 / 2.2))).all()


def test_mosaic_starts_with_red_and_interpolates_back():
    light = flat(0.0, (8, 8)) + np.array([0.8, 0.4, 0.2], np.float32)
    mosaic = expose(light, Sensor(colour="bayer", **QUIET), 0)
    np.testing.assert_array_equal(mosaic[:2, :2], [[204, 102], [102, 51]])
    colours = expose(light, Sensor(colour="demosaiced", **QUIET), 0)
    np.testing.assert_array_equal(colours, np.broadcast_to([204, 102, 51], (8, 8, 3)))


def test_grey_averages_the_colours_and_rgb_keeps_them():
    light = flat(0.0, (2, 2)) + np.array([0.6, 0.3, 0.0], np.float32)
    assert (expose(light, Sensor(**QUIET), 0) == round(0.3 * 255)).all()
    np.testing.assert_array_equal(expose(light, Sensor(colour="rgb", **QUIET), 0)[0, 0], [153, 76, 0])


def test_noise_seed_differs_per_camera_and_frame():
    images = {
        (camera, frame): expose(flat(0.5), Sensor(), make_noise_seed(1, camera, frame)).tobytes()
        for camera in ("cam0", "cam1")
        for frame in ("000", "001")
    }
    assert len(set(images.values())) == 4
    assert expose(flat(0.5), Sensor(), make_noise_seed(1, "cam1", "000")).tobytes() == images["cam1", "000"]
