"""Common numbering of the cameras' marker grids."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.core.geometry.rig import Rig
from beltscape.stereo.markers.grid import MarkerGrid, align_grids
from tests.stereo.raycast import make_world_rig

RNG = np.random.default_rng(8)
HEIGHTS_MM = RNG.uniform(0, 60, (4, 4))


def _place_markers(core_from_world) -> np.ndarray:
    """Return the (4, 4, 3) markers on relief, in the core's frame, mm."""
    x, y = np.meshgrid(np.linspace(-150, 150, 4), np.linspace(100, -100, 4))
    return core_from_world.apply(np.stack([x, y, HEIGHTS_MM], axis=-1))


def _make_scene() -> tuple[Rig, dict[str, MarkerGrid]]:
    rig, core_from_world = make_world_rig()
    points = _place_markers(core_from_world)
    whole = np.ones((4, 4), bool)
    grids = {
        name: MarkerGrid(
            camera.size_px,
            camera.project(rig.cam_from_core[name].apply(points)),
            whole,
            np.full((4, 4), 6.0),
            np.full((4, 4), 0.9),
        )
        for name, camera in rig.cameras.items()
    }
    return rig, grids


@pytest.mark.parametrize("turn", [1, 2, 3])
def test_grids_of_turned_cameras_get_the_numbering_of_the_others(turn):
    rig, grids = _make_scene()
    turned = grids["cam2"]
    grids["cam2"] = next(
        g for g in turned.list_numberings() if np.allclose(g.center_px, np.rot90(turned.center_px, turn))
    )
    agreed = align_grids(grids, rig)
    assert list(agreed) == list(rig.cameras)
    np.testing.assert_allclose(agreed["cam2"].center_px, turned.center_px)


def test_grid_that_contradicts_the_others_is_left_out():
    rig, grids = _make_scene()
    away = np.random.default_rng(2).uniform(-25, 25, (4, 4, 2))
    grids["cam3"] = replace(grids["cam3"], center_px=grids["cam3"].center_px + away)
    assert "cam3" not in align_grids(grids, rig)
