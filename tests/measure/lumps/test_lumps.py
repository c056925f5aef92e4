"""Lumps of ellipsoids and boxes of known size: segmentation, sizes, distribution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import InputError
from beltscape.measure.belt.empty_belt import find_belt
from beltscape.measure.lumps.lumps import FINES, assess_oversize, measure_lumps
from beltscape.measure.lumps.settings import LumpSettings
from tests.synthetic.packings import FLOOR_MM, Solid, camera, depth_map, make_ellipsoids, render_depth_map
from tests.thorough import examples, list_cases

DEFAULT = LumpSettings()


def nearest(lumps, eye, solid):
    """The lump whose middle is nearest to a solid's, in the core's frame."""
    x, y, _ = solid.center_mm
    return min(lumps.lumps, key=lambda lump: np.hypot(lump.center_mm[0] - x, -lump.center_mm[1] - y))


@pytest.fixture(scope="module")
def packed():
    solids = make_ellipsoids(np.random.default_rng(5))
    depth, which = render_depth_map(solids, camera(), noise_mm=0.05)
    return solids, depth, which, measure_lumps(depth, camera(), DEFAULT)


def test_each_ellipsoid_is_a_lump_of_its_size(packed):
    solids, _, _, lumps = packed
    assert len(lumps.lumps) == len(solids)
    for solid in solids:
        lump = nearest(lumps, camera(), solid)
        assert lump.size_mm == pytest.approx(solid.size_mm, rel=0.12)
        assert abs(lump.size_mm - solid.size_mm) < 3 * lump.sigma_mm
        assert lump.length_mm == pytest.approx(2 * max(solid.half_mm), rel=0.12)
        assert lump.volume_mm3 == pytest.approx(solid.volume_mm3, rel=0.5)
        assert not lump.occluded
        assert not lump.cut


def test_labels_are_the_solids_seen(packed):
    solids, _, which, lumps = packed
    for number, solid in enumerate(solids):
        lump = nearest(lumps, camera(), solid)
        own, true = lumps.labels == lump.number, which == number
        assert (own & true).sum() / (own | true).sum() > 0.85


def test_the_distribution_is_that_of_the_solids(packed):
    solids, _, _, lumps = packed
    size = np.array([solid.size_mm for solid in solids])
    mass = np.array([solid.volume_mm3 for solid in solids])
    order = np.argsort(size)
    half = size[order][np.searchsorted(np.cumsum(mass[order]), mass.sum() / 2)]
    assert lumps.all.d_mm[1] == pytest.approx(half, rel=0.08)
    assert lumps.all.count == lumps.whole.count == len(solids)


def test_boxes_are_lumps():
    solids = [
        Solid((x, y, FLOOR_MM - 20), (30, 22, 20), yaw_deg=10 + x / 3 + y, box=True)
        for x in (-160, -50, 60, 170)
        for y in (-120, 0, 120)
    ]
    depth, _ = render_depth_map(solids, camera(), noise_mm=0.05)
    lumps = measure_lumps(depth, camera(), DEFAULT)
    assert len(lumps.lumps) == len(solids)
    sizes = [lump.size_mm for lump in lumps.lumps]
    assert np.median(sizes) == pytest.approx(44, rel=0.1)
    assert sizes == pytest.approx([44.0] * 12, rel=0.27)  # off the axis one sees a side as well


@pytest.mark.parametrize("radius", list_cases([8.0, 20.0, 60.0], [8.0, 60.0]))
def test_one_lump(radius):
    ball = Solid((10.0, -20.0, FLOOR_MM - 0.8 * radius), (radius, radius, radius))
    depth, _ = render_depth_map([ball], camera())
    (lump,) = measure_lumps(depth, camera(), DEFAULT).lumps
    assert lump.size_mm == pytest.approx(2 * radius, rel=0.12)
    assert lump.center_mm[:2] == pytest.approx((10.0, 20.0), abs=0.15 * radius)


def test_a_plane_has_no_lumps():
    depth, _ = render_depth_map([], camera(), noise_mm=0.2)
    lumps = measure_lumps(depth, camera(), LumpSettings(oversize_mm=50))
    assert lumps.lumps == ()
    assert not (lumps.labels > 0).any()
    assert np.isnan(lumps.all.d_mm).all()
    assert lumps.oversize is not None
    assert not lumps.oversize.alarm
    assert lumps.oversize.probability == 0


def test_nothing_measured_is_no_lumps():
    lumps = measure_lumps(depth_map(np.full((500, 600), np.nan)), camera(), DEFAULT)
    assert lumps.lumps == ()
    assert lumps.labels.shape == (500, 600)


def test_of_two_that_overlap_the_lower_one_is_occluded():
    low = Solid((0.0, 0.0, FLOOR_MM - 20), (35, 30, 20))
    high = Solid((38.0, 0.0, FLOOR_MM - 62), (30, 28, 18))
    depth, _ = render_depth_map([low, high], camera())
    lumps = measure_lumps(depth, camera(), DEFAULT)
    under, over = (
        nearest(lumps, camera(), replace(low, center_mm=(-15.0, 0.0, 0.0))),
        nearest(lumps, camera(), high),
    )
    assert under.number != over.number
    assert under.occluded
    assert not over.occluded
    assert under.sigma_mm / under.size_mm > over.sigma_mm / over.size_mm


def test_a_lump_at_the_rim_of_the_frame_is_cut():
    inside = Solid((0.0, 0.0, FLOOR_MM - 20), (30, 28, 20))
    rim = Solid((297.0, 0.0, FLOOR_MM - 20), (30, 28, 20))
    depth, _ = render_depth_map([inside, rim], camera())
    lumps = measure_lumps(depth, camera(), DEFAULT)
    assert {lump.cut for lump in lumps.lumps} == {False, True}
    assert nearest(lumps, camera(), rim).cut
    assert lumps.all.count == 1


def test_holes_change_little(packed):
    solids, depth, _, whole = packed
    rng = np.random.default_rng(0)
    z = depth.depth_mm.copy()
    for _ in range(150):
        v, u = rng.integers(0, z.shape[0] - 6), rng.integers(0, z.shape[1] - 6)
        z[v : v + 6, u : u + 6] = np.nan
    z[rng.random(z.shape) < 0.1] = np.nan
    lumps = measure_lumps(depth_map(z), camera(), DEFAULT)
    assert len(lumps.lumps) == len(solids)
    assert lumps.all.d_mm[1] == pytest.approx(whole.all.d_mm[1], rel=0.05)


@pytest.mark.parametrize("turns", list_cases([1, 2, 3], [1]))
def test_turning_the_picture_turns_the_lumps(turns):
    eye = camera(320, 320)
    depth, _ = render_depth_map(
        make_ellipsoids(np.random.default_rng(2), columns=3, rows=3), eye, noise_mm=0.05
    )
    turned = depth_map(np.rot90(depth.depth_mm, turns))
    one, two = (measure_lumps(each, eye, DEFAULT) for each in (depth, turned))
    assert np.mean((np.rot90(one.labels, turns) > 0) == (two.labels > 0)) > 0.999
    sizes = [sorted(lump.size_mm for lump in each.lumps) for each in (one, two)]
    assert sizes[0] == pytest.approx(sizes[1], rel=0.01)


@given(st.floats(0.05, 20))
@examples(3)
def test_a_larger_world_has_larger_lumps(scale):
    eye = camera(300, 250, 350.0)
    solids = make_ellipsoids(np.random.default_rng(3), columns=4, rows=3, pitch_mm=100, largest_mm=45)
    one, _ = render_depth_map(solids, eye)
    many, _ = render_depth_map(solids, eye, scale=scale)
    first, second = (measure_lumps(each, eye, DEFAULT) for each in (one, many))
    assert len(first.lumps) == len(second.lumps) == 12
    for a, b in zip(first.lumps, second.lumps, strict=True):
        assert b.size_mm == pytest.approx(scale * a.size_mm, rel=0.01)
        assert b.volume_mm3 == pytest.approx(scale**3 * a.volume_mm3, rel=0.03)


def test_the_same_depth_gives_the_same_lumps(packed):
    _, depth, _, lumps = packed
    again = measure_lumps(depth, camera(), DEFAULT)
    assert again.lumps == lumps.lumps
    assert np.array_equal(again.labels, lumps.labels)


def test_over_a_known_belt_places_are_the_belts_and_what_is_no_lump_is_fines():
    eye = camera(300, 250, 350.0)
    solids = make_ellipsoids(np.random.default_rng(3), columns=4, rows=3)
    depth, _ = render_depth_map(solids, eye, noise_mm=0.05)
    empty, _ = render_depth_map([], eye, noise_mm=0.05)
    belt = find_belt(empty, eye)
    lumps = measure_lumps(depth, eye, DEFAULT, belt)
    assert lumps.frame == "belt"
    assert len(lumps.lumps) == len(solids)
    assert 0 <= lumps.fines_share < 0.35
    assert set(np.unique(lumps.labels)) <= {*range(len(solids) + 1), FINES}
    heights = [lump.center_mm[2] for lump in lumps.lumps]
    assert min(heights) > 5
    assert max(heights) < 60


def test_a_heap_below_the_belt_is_none():
    eye = camera(300, 250, 350.0)
    depth, _ = render_depth_map(make_ellipsoids(np.random.default_rng(3), columns=4, rows=3), eye)
    above, _ = render_depth_map([], eye, noise_mm=0.05)
    belt = find_belt(depth_map(above.depth_mm - 100), eye)
    assert measure_lumps(depth, eye, DEFAULT, belt).lumps == ()


def test_the_alarm_follows_the_limit(packed):
    _, _, _, lumps = packed
    largest = max(lump.size_mm for lump in lumps.lumps)
    chances = [assess_oversize(lumps.lumps, largest + step).probability for step in (-15, -5, 0, 5, 40)]
    assert chances == sorted(chances, reverse=True)
    assert chances[0] > 0.99
    assert chances[-1] < 0.01
    assert assess_oversize(lumps.lumps, largest - 5).alarm
    assert not assess_oversize(lumps.lumps, largest + 5).alarm


def test_another_cameras_depth_is_refused():
    with pytest.raises(InputError, match="600×500"):
        measure_lumps(depth_map(np.ones((20, 30))), camera(), DEFAULT)
