"""Simulated heaps: fines and rocks at rest."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import SettingsError
from beltscape.simulate.ray_casting import RayScene
from beltscape.simulate.shapes import Mesh, make_sphere, triangulate_height_field
from beltscape.simulate.solids.belt import BeltSettings, make_belt_solids
from beltscape.simulate.solids.fines import (
    FinesSettings,
    HeightField,
    limit_slope,
    make_fines,
    make_fines_mesh,
)
from beltscape.simulate.solids.heap import HeapSettings, make_heap, rasterise_rocks, shift_solids
from beltscape.simulate.solids.rocks import Rock, SizeSettings
from beltscape.simulate.world import Label
from tests.strategies import seeds
from tests.thorough import THOROUGH, examples

BELT = BeltSettings(length_mm=600)
SETTINGS = HeapSettings(
    seed=5,
    rocks=300 if THOROUGH else 80,
    fines=FinesSettings(along_mm=(-200, 200)),
    sizes=SizeSettings(smallest_mm=12, largest_mm=60),
)


@pytest.fixture(scope="module")
def heap():
    return make_heap(SETTINGS, BELT)


@examples(20)
@given(seed=seeds, slope=st.floats(0.1, 2))
def test_limited_slope_gives_the_highest_admissible_surface(seed, slope):
    rng = np.random.default_rng(seed)
    height = rng.normal(0, 20, (25, 30))
    ground = np.full((25, 30), -1e9)
    low = limit_slope(height, 3.0, 2.0, slope, ground)
    assert (low <= height).all()
    for axis, step in ((0, 2.0), (1, 3.0)):
        assert np.abs(np.diff(low, axis=axis)).max() <= slope * step + 1e-9
    for one, two in ((low[:-1, :-1], low[1:, 1:]), (low[1:, :-1], low[:-1, 1:])):
        assert np.abs(one - two).max() <= slope * np.hypot(3, 2) + 1e-9
    assert low.min() == height.min()  # the lowest node holds nothing up
    np.testing.assert_allclose(limit_slope(low, 3.0, 2.0, slope, ground), low)


@given(seed=seeds)
def test_heights_between_nodes_are_those_of_the_mesh(seed):
    rng = np.random.default_rng(seed)
    x, y = np.linspace(-5, 10, 6), np.linspace(2, 4, 5)
    field = HeightField(x, y, rng.normal(size=(5, 6)))
    mesh = triangulate_height_field(x, y, field.height_mm)
    weights = rng.dirichlet(np.ones(3), len(mesh.faces))
    points = (mesh.vertices_mm[mesh.faces] * weights[..., None]).sum(axis=1)
    np.testing.assert_allclose(field.height_at(points[:, 0], points[:, 1]), points[:, 2], atol=1e-9)
    np.testing.assert_array_equal(field.height_at(np.array([-6.0, 0.0]), np.array([3.0, 5.0])), -np.inf)


def test_fines_lie_on_the_belt_no_steeper_than_the_angle_of_repose():
    settings = FinesSettings(along_mm=(-150, 150), repose_deg=33, waves_mm=8, grain_mm=0)
    field = make_fines(settings, BELT, np.random.default_rng(1))
    mesh = make_fines_mesh(field, BELT)
    a, b, c = np.moveaxis(mesh.vertices_mm[mesh.faces], 1, 0)
    out = (mesh.vertices_mm[:, 2] > BELT.height_at(mesh.vertices_mm[:, 0], mesh.vertices_mm[:, 1]))[
        mesh.faces
    ]
    normal = np.cross(b - a, c - a)[out.all(axis=1)]
    steep = np.rad2deg(np.arctan2(np.linalg.norm(normal[:, :2], axis=1), normal[:, 2]))
    # held along the eight directions of the grid: in between a slope may be 8 % steeper, at a crest √2 times
    slope = np.tan(np.deg2rad(steep)) / np.tan(np.deg2rad(33))
    assert np.quantile(slope, 0.95) <= 1.09
    assert slope.max() <= np.sqrt(2) + 1e-9
    assert slope.max() > 1  # it matters
    load = field.height_mm - BELT.height_at(field.x_mm, field.y_mm[:, None])
    assert load.max() == pytest.approx(80, abs=30)
    assert load.min() >= -2.0 - 1e-9
    assert (load[:, [0, -1]] < 0).all()  # nothing on the edges
    assert np.abs(mesh.vertices_mm[:, 1]).max() < 290


def test_footprint_is_the_lower_and_upper_side_of_the_rock():
    ball = Rock(make_sphere(10.3, 0.01), 20.6)
    other = Rock(make_sphere(4.6, 0.01), 9.2)
    for rock, radius in zip(rasterise_rocks([ball, other, ball]), (10.3, 4.6, 10.3), strict=True):
        rows, columns = rock.reach
        y, x = np.mgrid[-rows : rows + 1, -columns : columns + 1]
        far = np.hypot(x, y)
        inside = far < radius - 0.1
        height = np.sqrt(radius**2 - far[inside] ** 2)
        np.testing.assert_allclose(rock.top_mm[inside], height, atol=0.1)
        np.testing.assert_allclose(rock.bottom_mm[inside], -height, atol=0.1)
        assert np.isinf(rock.bottom_mm[far > radius]).all()
        assert rock.height_mm == pytest.approx(2 * radius, abs=0.05)


def gaps(heap):
    """(N,) smallest vertical gap below each rock, mm, 0 where it lies in or on something; (N,) its depth in fines."""
    rocks = next(solid for solid in heap.solids if solid.name == "rocks")
    scene = RayScene([make_belt_solids(BELT)[0], *heap.solids])
    spread = np.concatenate([np.eye(3), np.random.default_rng(0).dirichlet(np.ones(3), 60)])
    lowest, depth = [], []
    for first, last in zip(heap.rocks.first_face, heap.rocks.first_face[1:], strict=False):
        corners = rocks.vertices_mm[rocks.faces[first:last]]
        under = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] < 0
        start = np.einsum("pk,fkd->fpd", spread, corners[under]).reshape(-1, 3) - np.array([0, 0, 1e-4])
        hits = scene.cast(start, np.tile([0.0, 0, -1], (len(start), 1)))
        inside = (
            scene.face_normals(hits.face)[:, 2] < 0
        )  # it leaves a solid downwards: the point is within it
        in_fines = heap.fines.height_at(start[:, 0], start[:, 1]) - start[:, 2]
        lowest.append(np.where(inside | (in_fines > 0), 0.0, hits.distance).min())
        depth.append(in_fines.max())
    return np.array(lowest), np.array(depth)


def heights(heap):
    z = next(solid for solid in heap.solids if solid.name == "rocks").vertices_mm[:, 2]
    return np.array(
        [np.ptp(z[a:b]) for a, b in zip(heap.rocks.first_vertex, heap.rocks.first_vertex[1:], strict=False)]
    )


def test_rocks_neither_float_nor_sink(heap):
    lowest, depth = gaps(heap)
    assert lowest.max() < 1.0  # mm
    # as deep as its bedding; between the raster's points a corner may be a millimetre deeper
    assert (depth <= SETTINGS.bedding * heights(heap) + 1.5).all()
    assert depth.max() > 3.0


def test_rocks_do_not_intersect_the_belt_and_hardly_each_other(heap):
    rocks = next(solid for solid in heap.solids if solid.name == "rocks")
    v = rocks.vertices_mm
    assert (v[:, 2] - BELT.height_at(v[:, 0], v[:, 1])).min() > -1.0
    # straight up from a vertex: the surface left before another is entered is one the vertex is within
    scene = RayScene([rocks])
    hits = scene.cast(v + np.array([0, 0, 1e-3]), np.tile([0.0, 0, 1], (len(v), 1)))
    owner = np.repeat(np.arange(SETTINGS.rocks), np.diff(heap.rocks.first_face))
    mine = np.repeat(np.arange(SETTINGS.rocks), np.diff(heap.rocks.first_vertex))
    met = np.isfinite(hits.distance)
    within = met & (scene.face_normals(hits.face)[:, 2] > 0) & (owner[hits.face] != mine)
    assert within.mean() < 0.02


def test_record_of_each_rock_matches_its_part_of_the_mesh(heap):
    rocks = next(solid for solid in heap.solids if solid.name == "rocks")
    records = heap.rocks
    assert records.first_face[-1] == len(rocks.faces)
    for i in (0, 17, SETTINGS.rocks - 1):
        vertices = slice(records.first_vertex[i], records.first_vertex[i + 1])
        faces = rocks.faces[records.first_face[i] : records.first_face[i + 1]] - records.first_vertex[i]
        mesh = Mesh(rocks.vertices_mm[vertices], faces)
        assert mesh.is_closed
        assert mesh.volume_mm3 == pytest.approx(records.volume_mm3[i], rel=1e-9)
        assert (np.abs(mesh.vertices_mm.mean(axis=0) - records.center_mm[i]) < 0.2 * records.size_mm[i]).all()
    assert (records.size_mm.min() >= 12) and (records.size_mm.max() <= 60)


def test_solids_have_labels_and_textures(heap):
    assert [solid.name for solid in heap.solids] == ["fines", "rocks"]
    for solid in heap.solids:
        assert solid.label == Label.MATERIAL
        assert solid.texture.mean() == pytest.approx(0.09, rel=0.15)
        assert solid.texture.std() > 0.2 * 0.09
        assert solid.uv.min() >= 0
        assert solid.uv.max() <= 1
        assert solid.faces.max() == len(solid.vertices_mm) - 1


def test_heap_depends_on_the_seed_only(heap):
    small = SETTINGS.model_copy(update={"rocks": 40})
    one, two = make_heap(small, BELT), make_heap(small, BELT)
    for a, b in zip(one.solids, two.solids, strict=True):
        np.testing.assert_array_equal(a.vertices_mm, b.vertices_mm)
        np.testing.assert_array_equal(a.texture, b.texture)
    other = make_heap(small.model_copy(update={"seed": 6}), BELT)
    assert np.abs(other.rocks.center_mm - one.rocks.center_mm).max() > 10
    np.testing.assert_array_equal(heap.fines.height_mm, one.fines.height_mm)


def test_rolling_rocks_gather_at_the_flanks():
    lying, rolled = (
        np.abs(make_heap(SETTINGS.model_copy(update={"rolling": rolling}), BELT).rocks.center_mm[:, 0])
        for rolling in (0.0, 1.0)
    )
    assert rolled.mean() > 1.2 * lying.mean()


def test_heap_may_consist_of_rocks_or_fines_alone():
    bare = FinesSettings(crown_mm=0, waves_mm=0, grain_mm=0)
    rocks = make_heap(SETTINGS.model_copy(update={"rocks": 20, "fines": bare}), BELT)
    assert [solid.name for solid in rocks.solids] == ["rocks"]
    v = rocks.solids[0].vertices_mm
    assert (v[:, 2] - BELT.height_at(v[:, 0], v[:, 1])).min() == pytest.approx(0, abs=1.0)
    fines = make_heap(SETTINGS.model_copy(update={"rocks": 0}), BELT)
    assert [solid.name for solid in fines.solids] == ["fines"]
    assert fines.rocks.center_mm.shape == (0, 3)


def test_shifted_heap_moves_along_the_belt(heap):
    for before, after in zip(heap.solids, shift_solids(heap.solids, 250.0), strict=True):
        np.testing.assert_allclose(
            after.vertices_mm - before.vertices_mm, np.tile([0, 250.0, 0], (len(before.vertices_mm), 1))
        )
        assert (after.name, after.texture is before.texture) == (before.name, True)


def test_rocks_wider_than_the_belt_are_refused():
    huge = SizeSettings(smallest_mm=240, largest_mm=250)
    narrow = BeltSettings(flat_mm=80, width_mm=200, length_mm=200)
    with pytest.raises(SettingsError, match="no place for rocks of 2"):
        make_heap(SETTINGS.model_copy(update={"rocks": 2, "sizes": huge}), narrow)
