"""Surroundings are what lies about a pixel, neighbour by neighbour."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.kernels import load
from beltscape.stereo.multiview.selection.neighbourhood import Neighbourhood, sample_planes

SHAPE = (20, 30)
AT = (np.array([9, 10, 0]), np.array([12, 15, 29]))


def planes(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A surface, impressions and levels."""
    rng = np.random.default_rng(seed)
    s, impression = rng.normal(0, 0.5, (2, *SHAPE)).astype(np.float32)
    return s, impression, rng.uniform(0, 200, SHAPE).astype(np.float32)


@pytest.mark.parametrize(("scale", "spread"), [(0.5, 1), (1.0, 1), (1.8, 2)])
def test_each_name_is_of_its_neighbour(scale, spread):
    s, impression, core = planes()
    around = Neighbourhood.of(s, impression, core, 2, scale, load())
    about, slope = around.about(AT), np.array([0.2, -0.1, 0.3], np.float32)
    relief = around.relief(AT, s[AT], slope, 2 * slope)
    assert len(about) == 2 * len(relief) == 48
    for du, dv in ((1, 0), (-2, 1), (2, 2), (0, -1)):
        name, (y, x) = f"at {du:+d} {dv:+d}", (AT[0][:2] + spread * dv, AT[1][:2] + spread * du)
        np.testing.assert_array_equal(about[f"impression {name}"][:2], impression[y, x])
        brighter = np.log((core[y, x] + 8) / (core[AT][:2] + 8))
        np.testing.assert_allclose(about[f"brightness {name}"][:2], brighter, atol=1e-5)
        off = (s[y, x] - s[AT][:2] - slope[:2] * spread * (du + 2 * dv)) / scale
        np.testing.assert_allclose(relief[f"relief {name}"][:2], np.clip(off, -3, 3), atol=1e-5)


def test_beyond_the_edge_its_pixels_stand_in_and_gaps_say_nothing():
    s, impression, core = planes(1)
    s[10, 16] = core[10, 16] = np.nan
    around = Neighbourhood.of(s, impression, core, 2, 1.0, load())
    flat = np.zeros(3, np.float32)
    about, relief = around.about(AT), around.relief(AT, s[AT], flat, flat)
    assert about["impression at +2 -2"][2] == impression[0, 29]
    assert relief["relief at +1 +0"][1] == 0
    assert all(np.isfinite(values).all() for values in (about | relief).values())


def test_pixels_are_picked_by_name():
    s, impression, _ = planes(2)
    found = sample_planes({"a": s, "b": impression}, AT, load())
    np.testing.assert_array_equal(found["a"], s[AT])
    np.testing.assert_array_equal(found["b"], impression[AT])


@pytest.mark.parametrize(("reach", "count"), [(1, 8), (2, 24)])
def test_they_reach_as_far_as_asked(reach, count):
    around = Neighbourhood.of(*planes(3), reach, 1.0, load())
    names = [name.split()[2:] for name in around.relief(AT, *np.zeros((3, 3), np.float32))]
    assert len(names) == count
    assert max(abs(int(px)) for name in names for px in name) == reach
