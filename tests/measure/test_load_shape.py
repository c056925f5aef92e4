"""The shape of a load: centre of gravity, fill level, highest point, and its closed mesh."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from beltscape.core.empty_belt import Belt
from beltscape.measure.belt.empty_belt import learn_belt
from beltscape.measure.volume.load import compute_capacity_mm2
from beltscape.measure.volume.settings import VolumeSettings
from beltscape.measure.volume.solid import build_load_mesh, build_surface_mesh
from beltscape.measure.volume.volume import Volume, measure_volume
from tests.measure.belt_scenes import Block, Cone, Scene, camera_of, depth_map, trough

TROUGH = trough(300, (250, 25))
WIDE: dict[str, Any] = {"across_mm": (-200.0, 200.0), "along_mm": (-200.0, 200.0)}
CONE = Cone((30.0, -40.0), 90.0, 60.0)


BELTS: dict[tuple[Any, ...], Belt] = {}
"""Belts that tests have learned, by their view."""


def measured(solids: tuple, box: dict[str, Any] = WIDE, **view: Any) -> Volume:
    empty, loaded = Scene(TROUGH, **view), Scene(TROUGH, solids, **view)
    key = tuple(view.items())
    if key not in BELTS:
        BELTS[key] = learn_belt([depth_map(empty.depth_mm(), noise_mm=0.05, seed=1)], empty.camera)
    depth = depth_map(loaded.depth_mm(), noise_mm=0.05, seed=2)
    return measure_volume(depth, BELTS[key], empty.camera, VolumeSettings(), **box)


@pytest.fixture(scope="module")
def cone() -> Volume:
    return measured((CONE,), camera=camera_of(420))


def test_centre_of_a_cone(cone: Volume) -> None:
    origin = cone.belt.belt_from_core.translation_mm  # the camera stands over x = y = 0
    assert cone.centre is not None
    place = np.array(cone.centre.position_mm) - [origin[0], origin[1], 0]
    np.testing.assert_allclose(place, [30, -40, 15], atol=0.7)
    sigma_mm = cone.centre.off_middle_sigma_mm  # the belt's ends are out of view
    assert sigma_mm < 4
    assert cone.centre.off_middle_mm == pytest.approx(30, abs=2 * sigma_mm)
    assert max(cone.centre.sigma_mm) < 2


def test_an_empty_belt_has_no_centre() -> None:
    assert measured((), camera=camera_of(420)).centre is None


def test_highest_place(cone: Volume) -> None:
    assert cone.summit is not None
    assert cone.summit.height_mm == pytest.approx(60, abs=3)


def test_capacity_is_dins_for_three_rolls() -> None:
    flat, wing, angle, surcharge = 300.0, 220.0, np.deg2rad(25), np.deg2rad(15)
    section = trough(flat, (wing, 25))
    belt = learn_belt([depth_map(Scene(section, floor_mm=-60.0).depth_mm())], Scene(section).camera)
    belt = replace(belt, edges=None, across_mm=(float(section[0, 0]), float(section[-1, 0])))
    b = 0.9 * (flat + 2 * wing) - 50
    chord = flat + (b - flat) * np.cos(angle)
    surcharged = chord**2 * np.tan(surcharge) / 4
    level = (flat + (b - flat) / 2 * np.cos(angle)) * (b - flat) / 2 * np.sin(angle)
    assert compute_capacity_mm2(belt, surcharge) == pytest.approx(surcharged + level, rel=0.01)


def test_volume_adds_up_over_boxes(cone: Volume) -> None:
    cut = -37.3
    parts = [
        measured((CONE,), {**WIDE, "along_mm": part}, camera=camera_of(420)).volume_mm3
        for part in ((-200.0, cut), (cut, 200.0))
    ]
    assert sum(parts) == pytest.approx(cone.volume_mm3, rel=1e-3)


@pytest.mark.parametrize(
    "view",
    [{"belt_yaw_deg": 40.0}, pytest.param({"camera_mm": (40.0, 25.0, 740.0)}, marks=pytest.mark.thorough)],
)
def test_volume_does_not_depend_on_where_the_camera_stands(cone: Volume, view: dict[str, Any]) -> None:
    found = measured(
        (CONE,), {"across_mm": (-220.0, 220.0), "along_mm": (-220.0, 220.0)}, camera=camera_of(420), **view
    )
    assert found.volume_mm3 == pytest.approx(cone.volume_mm3, rel=0.01)


def test_the_body_is_closed_and_holds_the_volume() -> None:
    found = measured((CONE, Block((-80.0, 60.0), (60.0, 60.0, 40.0))), camera=camera_of(420))
    body = build_load_mesh(found)
    assert body.volume_mm3 == pytest.approx(found.volume_mm3, rel=2e-3)
    sides = np.sort(
        np.concatenate([body.faces[:, [0, 1]], body.faces[:, [1, 2]], body.faces[:, [2, 0]]]), axis=1
    )
    assert (np.unique(sides, axis=0, return_counts=True)[1] == 2).all()
    top = build_surface_mesh(found)
    first, second, third = (top.vertices_mm[top.faces[:, k]] for k in range(3))
    normal = np.cross(second - first, third - first)
    assert (normal[:, 2] > 0).all()
