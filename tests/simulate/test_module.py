"""The simulated calibration module."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.simulate.ray_casting import RayScene
from beltscape.simulate.shapes import Mesh
from beltscape.simulate.solids.board import make_module_solids, place_module
from beltscape.simulate.world import Label
from beltscape.target.module import Base, Cube, Cylinder, Module, Sphere

MODULE = Module(
    base=Base(size_mm=(285, 200, 10)),
    cube=(
        Cube(name="cube100", edge_mm=100, center_mm=(85, -42)),
        Cube(name="cube40", edge_mm=40, center_mm=(112, 70)),
    ),
    sphere=(Sphere(name="sphere30", diameter_mm=30, center_mm=(-75, 15)),),
    cylinder=(Cylinder(name="post", diameter_mm=20, height_mm=90, center_mm=(-118, 68)),),
)
VOLUMES = [285 * 200 * 10, 1e6, 64000, np.pi / 6 * 30**3, np.pi * 100 * 90]


def test_every_part_is_closed_labelled_and_has_its_volume():
    solids = make_module_solids(MODULE, place_module(MODULE, 6.0, 9.5, -17.6))
    assert [solid.label for solid in solids] == [Label.BASE, 11, 12, 13, 14]
    assert [solid.name for solid in solids] == ["base", "cube100", "cube40", "sphere30", "post"]
    for solid, volume in zip(solids, VOLUMES, strict=True):
        mesh = Mesh(solid.vertices_mm, solid.faces)
        assert mesh.is_closed
        assert mesh.volume_mm3 == pytest.approx(volume, rel=1e-9)


def test_features_have_their_positions_seen_from_above():
    pose = place_module(MODULE, 6.0, 9.5, 30.0, belt_mm=2.0)
    scene = RayScene(make_module_solids(MODULE, pose))
    places = np.array([[0, -90], [85, -42], [112, 70], [-75, 15], [-118, 68], [134, 6], [136, 9]])
    heights = [0, 100, 40, 30, 90, 100, 0]
    above = pose.apply(np.column_stack([places, np.full(7, 300.0)]).astype(float))
    hits = scene.cast(above, np.tile([0.0, 0.0, -1.0], (7, 1)))
    top = above[:, 2] - hits.distance
    np.testing.assert_allclose(top, np.array(heights) + 12.0, atol=0.003)
    assert scene.label_of_face[hits.face].tolist() == [10, 11, 12, 13, 14, 11, 10]


def test_base_lies_on_the_belt_and_turns_about_z():
    pose = place_module(MODULE, 0.0, 0.0, 90.0)
    base = make_module_solids(MODULE, pose)[0]
    np.testing.assert_allclose(np.ptp(base.vertices_mm, axis=0), [200, 285, 10])
    assert base.vertices_mm[:, 2].min() == pytest.approx(0.0)
    np.testing.assert_allclose(pose.apply(np.array([1.0, 0, 0])), [0, 1, 10], atol=1e-12)
