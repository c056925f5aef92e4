"""The simulated belt: its trough, sag and misalignment."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from beltscape.simulate.shapes import Mesh
from beltscape.simulate.solids.belt import BeltSettings, make_belt_solids
from beltscape.simulate.world import Label
from tests.thorough import examples

belts = st.builds(
    BeltSettings,
    flat_mm=st.floats(100, 400),
    wing_deg=st.one_of(st.just(0.0), st.floats(5, 45)),
    width_mm=st.floats(500, 1200),
    fold_radius_mm=st.one_of(st.just(0.0), st.floats(5, 400)),
    misaligned_mm=st.floats(-30, 30),
    sag_mm=st.sampled_from([0.0, 8.0]),
)


def test_sharp_trough_equals_the_analytic_one():
    belt = BeltSettings(fold_radius_mm=0)
    np.testing.assert_allclose(
        belt.section_mm,
        [
            [-376.5769467591625, 105.65456543517486],
            [-150, 0],
            [150, 0],
            [376.5769467591625, 105.65456543517486],
        ],
    )
    np.testing.assert_allclose(belt.height_at([0, 149, 250, -250]), [0, 0, 46.630766, 46.630766], atol=1e-6)
    assert np.isnan(belt.height_at([-377, 377])).all()


@examples(30)
@given(belt=belts)
def test_section_has_the_width_of_the_belt_and_bends_only_by_its_angle(belt):
    step = np.diff(belt.section_mm, axis=0)
    assert (step[:, 0] > 0).all()
    assert np.linalg.norm(step, axis=1).sum() == pytest.approx(belt.width_mm, rel=1e-4)
    slope = np.arctan2(step[:, 1], step[:, 0])
    assert (np.diff(slope) > -1e-9).all()
    np.testing.assert_allclose(slope[[0, -1]], np.deg2rad([-belt.wing_deg, belt.wing_deg]), atol=1e-9)


@examples(20)
@given(belt=belts)
def test_slab_is_closed_and_its_upper_side_is_height_at(belt):
    slab, floor = make_belt_solids(belt)
    mesh = Mesh(slab.vertices_mm, slab.faces)
    assert mesh.is_closed
    nominal_mm3 = belt.width_mm * belt.thickness_mm * belt.length_mm
    # the corners of the lower side lie one thickness below those of the upper side
    at_folds = np.cos(np.deg2rad(belt.wing_deg) / 2)
    assert 0.99 * at_folds * nominal_mm3 < mesh.volume_mm3 < 1.01 * nominal_mm3
    corners = mesh.vertices_mm[mesh.faces]
    up = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 1e-6
    middle = corners[up].mean(axis=1)
    assert len(middle) >= 2 * (len(belt.section_mm) - 1)
    assert mesh.vertices_mm[:, 0].max() == belt.half_width_mm[1]  # from above one sees the upper side only
    np.testing.assert_allclose(belt.height_at(middle[:, 0], middle[:, 1]), middle[:, 2], atol=1e-9)
    assert (slab.label, floor.label) == (Label.BELT, Label.FLOOR)


def test_misaligned_belt_climbs_on_one_side_and_keeps_its_trough():
    straight, off = BeltSettings(), BeltSettings(misaligned_mm=25)
    along_wing = 25 * np.cos(np.deg2rad(25))
    assert off.half_width_mm[1] - straight.half_width_mm[1] == pytest.approx(along_wing)
    assert straight.half_width_mm[0] - off.half_width_mm[0] == pytest.approx(along_wing)
    x = np.linspace(-300, 300, 50)
    np.testing.assert_allclose(off.height_at(x), straight.height_at(x), atol=1e-9)


def test_belt_sags_between_its_idlers():
    belt = BeltSettings(sag_mm=6, idler_pitch_mm=1000)
    np.testing.assert_allclose(belt.height_at(0, [0, 500, -500]), [0, -6, -6], atol=0.01)


def test_belt_narrower_than_its_flat_is_refused():
    with pytest.raises(ValidationError, match="leaves no wing"):
        BeltSettings(flat_mm=500, width_mm=400)
