"""Motion blur of a moving belt."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.simulate.rendering.optics import Optics
from beltscape.simulate.rendering.render import (
    RenderSettings,
    render_exposure,
    sample_exposure,
    shift_labelled,
)
from beltscape.simulate.world import Label, World
from tests.synthetic.light import camera, plane, station


@pytest.fixture
def world():
    return World((plane(900, 900, z_mm=-50.0), plane(12, 12, label=Label.MATERIAL)), None)


def test_material_moves_and_the_belt_stays(world):
    after = shift_labelled(world, 7.0)
    np.testing.assert_array_equal(after.solids[0].vertices_mm, world.solids[0].vertices_mm)
    np.testing.assert_allclose(after.solids[1].vertices_mm - world.solids[1].vertices_mm, [[0, 7, 0]] * 4)


def test_instants_are_even_small_steps_about_the_middle(world):
    rig = station(camera())
    y = np.array([world.solids[1].vertices_mm[0, 1] for world in sample_exposure(world, rig, 5.0)])
    middle = world.solids[1].vertices_mm[0, 1]
    assert y.mean() == pytest.approx(middle)
    np.testing.assert_allclose(np.diff(y), 5.0 / len(y))
    assert np.diff(y).max() * camera().focal_px.max() / 700 <= 0.3
    assert len(sample_exposure(world, rig, 0.0)) == 1


def test_exposure_blurs_along_the_belt_only():
    cam = camera(120, 100, focal=300.0, distortion=(0.0,) * 5)
    rig, settings = station(cam), RenderSettings(engine="scalar", oversample=3, passes=8)
    spot = World((plane(12, 12, label=Label.MATERIAL),), None)
    still, smeared = (
        render_exposure(sample_exposure(spot, rig, travel), rig, {"cam0": Optics()}, settings)["cam0"][..., 0]
        for travel in (0.0, 20.0)
    )
    assert smeared.sum() == pytest.approx(still.sum(), rel=0.01)
    (along, across), (along_still, across_still) = variances(smeared), variances(still)
    travel_px = 20 * cam.focal_px[1] / 700
    assert across == pytest.approx(across_still, rel=0.02)
    assert along - along_still == pytest.approx(travel_px**2 / 12, rel=0.03)


def variances(image):
    """Along rows' index (the belt's direction here) and along columns."""
    found = []
    for axis in (1, 0):
        light, at = image.sum(axis=axis), np.arange(image.shape[1 - axis])
        middle = (light * at).sum() / light.sum()
        found.append((light * (at - middle) ** 2).sum() / light.sum())
    return found
