"""Patterns, materials and rigs of other makers than the paper's."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.simulate.grains import GRAIN_PATTERNS
from beltscape.simulate.rig_and_projector import make_projector, make_station
from beltscape.simulate.scenario import ProjectorSpec, RigSpec
from beltscape.simulate.solids.belt import BeltSettings
from beltscape.simulate.solids.heap import HeapSettings, make_heap
from beltscape.simulate.solids.rocks import ShapeSettings, make_rock

SIZE_PX = (320, 200)


@pytest.mark.parametrize("name", GRAIN_PATTERNS)
def test_half_of_the_pattern_is_lit_in_grains_of_the_stated_size(name):
    lit = GRAIN_PATTERNS[name](SIZE_PX, 4.0, 7)
    assert lit.shape == SIZE_PX[::-1] and 0.45 < lit.mean() < 0.55
    assert (GRAIN_PATTERNS[name](SIZE_PX, 4.0, 7) == lit).all() and (
        GRAIN_PATTERNS[name](SIZE_PX, 4.0, 8) != lit
    ).any()
    runs = SIZE_PX[0] / (1 + np.count_nonzero(np.diff(lit, axis=1), axis=1))  # mean length of a run, px
    twice = GRAIN_PATTERNS[name]((640, 200), 8.0, 7)
    runs_of_twice = 640 / (1 + np.count_nonzero(np.diff(twice, axis=1), axis=1))
    assert 3.5 < runs.mean() < 12.0
    assert runs_of_twice.mean() == pytest.approx(2 * runs.mean(), rel=0.15)


def test_noise_has_no_large_patches_and_cells_do():
    share = {
        name: np.lib.stride_tricks.sliding_window_view(GRAIN_PATTERNS[name](SIZE_PX, 4.0, 7), (20, 20))
        .mean((2, 3))
        .std()
        for name in ("noise", "cells")
    }
    assert share["noise"] < 0.5 * share["cells"]


def test_the_projector_casts_the_grains():
    spec = ProjectorSpec(pattern="cells", cell_px=5, size_px=SIZE_PX, blur_px=0, gamma=2.2)
    light = make_projector(spec).pattern
    assert light.shape == (200, 320, 3) and set(np.unique(light)) == {0.0, 1.0}
    assert (light[:5, :5] == light[0, 0]).all()


def test_auxiliaries_have_their_own_distances_and_the_core_its_tilt():
    spec = RigSpec(auxiliaries=2, around_deg=180, baselines_mm=(260.0, 200.0), tilt_deg=6.0, scatter=0.0)
    station = make_station(spec)
    centers = [station.cam_from_world(f"cam{i}").center_mm for i in range(3)]
    np.testing.assert_allclose(centers, [[0, 0, 744], [260, 0, 744], [0, 200, 744]], atol=1e-9)
    axis = station.cam_from_world("cam0").rotation[2]
    assert np.rad2deg(np.arctan2(axis[1], -axis[2])) == pytest.approx(6.0)
    with pytest.raises(ValueError, match="baselines_mm has 1 numbers"):
        RigSpec(auxiliaries=2, baselines_mm=(260.0,))


def test_pressed_bodies_have_the_chosen_form_and_rocks_their_gloss():
    shapes = ShapeSettings(pressed=1.0, forms=("cuboid",))
    rng = np.random.default_rng(3)
    assert all(len(make_rock(20.0, shapes, rng).mesh.vertices_mm) == 8 for _ in range(10))
    settings = HeapSettings(rocks=5, shapes=shapes, gloss=0.4)
    gloss = {solid.name: solid.gloss for solid in make_heap(settings, BeltSettings()).solids}
    assert gloss == {"fines": 0.0, "rocks": 0.4}
