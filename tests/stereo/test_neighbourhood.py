"""Context features: the values of single neighbours of a pixel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.kernels import load
from beltscape.stereo.multiview.frame import MatchContext, Noise, PreparedFrame
from beltscape.stereo.multiview.refined_features import Neighbourhood, sample_planes
from tests.stereo.scenes import make_ring

SHAPE = (20, 30)
AT = (np.array([9, 10, 0]), np.array([12, 15, 29]))


def make_frame(core: np.ndarray, scale: float = 1.0) -> PreparedFrame:
    """Return a frame without auxiliaries."""
    context = MatchContext.for_grid(rig := make_ring(), rig.auxiliaries, 1, load(), 1)
    context = replace(context, windows=replace(context.windows, scale=scale))
    return PreparedFrame(core, (), (), np.empty((0, 39), np.float32), Noise(1, 1, 1), context)


def planes(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a surface, its initial confidence and levels."""
    rng = np.random.default_rng(seed)
    s, confidence = rng.normal(0, 0.5, (2, *SHAPE)).astype(np.float32)
    return s, confidence, rng.uniform(0, 200, SHAPE).astype(np.float32)


@pytest.mark.parametrize(("scale", "spread"), [(0.5, 1), (1.0, 1), (1.8, 2)])
def test_features_are_the_values_of_the_named_neighbours(scale, spread):
    s, confidence, core = planes()
    neighbourhood = Neighbourhood.from_surface(s, confidence, make_frame(core, scale))
    image, slope = neighbourhood.compute_image_features(AT), np.array([0.2, -0.1, 0.3], np.float32)
    offset = neighbourhood.compute_offset_features(AT, s[AT], (slope, 2 * slope))
    assert len(image) == 2 * len(offset) == 16
    for du, dv in ((1, 0), (-1, 1), (1, 1), (0, -1)):
        name, (y, x) = f"at {du:+d} {dv:+d}", (AT[0][:2] + spread * dv, AT[1][:2] + spread * du)
        np.testing.assert_array_equal(image[f"initial confidence {name}"][:2], confidence[y, x])
        brighter = np.log((core[y, x] + 8) / (core[AT][:2] + 8))
        np.testing.assert_allclose(image[f"relative brightness {name}"][:2], brighter, atol=1e-5)
        off = (s[y, x] - s[AT][:2] - slope[:2] * spread * (du + 2 * dv)) / scale
        np.testing.assert_allclose(offset[f"offset {name}"][:2], np.clip(off, -3, 3), atol=1e-5)


def test_neighbours_beyond_the_edge_repeat_and_gaps_have_no_offset():
    s, confidence, core = planes(1)
    s[10, 16] = core[10, 16] = np.nan
    neighbourhood = Neighbourhood.from_surface(s, confidence, make_frame(core))
    flat = np.zeros(3, np.float32)
    image = neighbourhood.compute_image_features(AT)
    offset = neighbourhood.compute_offset_features(AT, s[AT], (flat, flat))
    assert image["initial confidence at +1 -1"][2] == confidence[0, 29]
    assert offset["offset at +1 +0"][1] == 0
    assert all(np.isfinite(values).all() for values in (image | offset).values())


def test_planes_are_sampled_by_name():
    s, confidence, _ = planes(2)
    found = sample_planes({"a": s, "b": confidence}, AT, load())
    np.testing.assert_array_equal(found["a"], s[AT])
    np.testing.assert_array_equal(found["b"], confidence[AT])
