"""Triangle meshes of simple shapes: closed, with their volume."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.simulate.shapes import (
    Mesh,
    extrude,
    join_meshes,
    make_box,
    make_cylinder,
    make_icosahedron,
    make_sphere,
    subdivide,
    triangulate_height_field,
)
from tests.strategies import poses
from tests.thorough import examples

SHAPES = {
    "box": (make_box([30.0, 20.0, 7.0]), 30 * 20 * 7),
    "cylinder": (make_cylinder(10.0, 90.0), np.pi * 100 * 90),
    "sphere": (make_sphere(15.0), 4 / 3 * np.pi * 15**3),
    "icosahedron": (make_icosahedron(), 2.536150710),
}


@pytest.mark.parametrize("name", SHAPES)
def test_shape_is_closed_and_has_its_volume(name):
    mesh, volume = SHAPES[name]
    assert mesh.is_closed
    assert mesh.volume_mm3 == pytest.approx(volume, rel=1e-9)  # positive: its faces look outside


@examples(20)
@given(pose=poses(), name=st.sampled_from(sorted(SHAPES)))
def test_transform_and_subdivision_keep_volume_and_closedness(pose, name):
    mesh, volume = SHAPES[name]
    if len(mesh.faces) > 5000:
        return
    changed = subdivide(mesh).transform(pose)
    assert changed.is_closed
    assert len(changed.faces) == 4 * len(mesh.faces)
    assert changed.volume_mm3 == pytest.approx(volume, rel=1e-7)


@pytest.mark.parametrize("radius", [5.0, 15.0, 35.0])
def test_sphere_deviates_by_less_than_three_micrometres(radius):
    mesh = make_sphere(radius)
    corners = mesh.vertices_mm[mesh.faces]
    weights = np.random.default_rng(1).dirichlet(np.ones(3), 7)  # places within each face
    on_faces = np.einsum("pk,fkd->fpd", weights, corners)
    for points in (mesh.vertices_mm, on_faces, corners.mean(axis=1)):
        assert np.abs(np.linalg.norm(points, axis=-1) - radius).max() < 0.003


@pytest.mark.parametrize("radius", [2.0, 10.0, 80.0])
def test_side_of_a_cylinder_deviates_by_less_than_three_micrometres(radius):
    mesh = make_cylinder(radius, 5.0)
    ring = mesh.vertices_mm[mesh.vertices_mm[:, 2] == 0][:-1]
    middles = (ring + np.roll(ring, 1, axis=0)) / 2
    for points in (ring, middles):
        assert np.abs(np.linalg.norm(points[:, :2], axis=1) - radius).max() < 0.003


def test_extrusion_is_closed_and_has_the_volume_section_times_length():
    outline = np.array([[-3.0, 2], [0, 1], [3, 2], [3, 1], [0, 0], [-3, 1]])
    mesh = extrude(outline, np.array([-5.0, 0.0, 7.0]))
    assert mesh.is_closed
    assert mesh.volume_mm3 == pytest.approx(6 * 12)


def test_height_field_faces_up_and_contains_its_nodes():
    x, y = np.array([0.0, 1, 3]), np.array([-1.0, 2])
    mesh = triangulate_height_field(x, y, np.array([[0.0, 1, 2], [3, 4, 9]]))
    a, b, c = np.moveaxis(mesh.vertices_mm[mesh.faces], 1, 0)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()
    np.testing.assert_array_equal(mesh.vertices_mm[4], [1, 2, 4])


def test_joined_meshes_keep_their_volumes_and_a_missing_face_opens_them():
    both = join_meshes([make_box([1, 2, 3]), make_sphere(2.0, 0.1)])
    assert both.is_closed
    assert both.volume_mm3 == pytest.approx(6 + 4 / 3 * np.pi * 8)
    assert not Mesh(both.vertices_mm, both.faces[1:]).is_closed
    turned = both.faces.copy()
    turned[0] = turned[0, ::-1]
    assert not Mesh(both.vertices_mm, turned).is_closed
