"""The true depth, visibility and light of a simulated frame."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.simulate.core_truth import label_rocks, measurable_shares, trace_core_truth, trace_core_view
from beltscape.simulate.ray_casting import RayScene
from beltscape.simulate.shapes import make_box, make_sphere
from beltscape.simulate.solids.heap import HeapSettings, make_heap
from beltscape.simulate.truth_files import compute_true_area_mm2, compute_true_load
from beltscape.simulate.world import Label
from tests.simulate.scenes import BELT, SIZE_PX, load, station, world


def test_pinhole_grid_and_the_image_show_the_same_surface():
    here, there = station(), world(load(make_box([80, 60, 50])))
    camera, pose = here.rig.core_camera, here.core_from_world
    pinhole, image = trace_core_view(there, here), trace_core_view(there, here, distorted=True)
    for truth, distorted in ((pinhole, False), (image, True)):
        rows, columns = np.nonzero(truth.label == Label.MATERIAL)
        assert len(rows) > 100
        pixels = np.column_stack([columns, rows]).astype(float)
        plane = camera.undistort(pixels) if distorted else (pixels - camera.center_px) / camera.focal_px
        depth = truth.depth_mm[rows, columns, None]
        points = pose.inverse().apply(np.column_stack([plane * depth, depth]))
        gap = np.abs(points - [0, 0, 25]) - [40, 30, 25]  # on the box's surface: inside, and on one face
        assert np.abs(gap.max(axis=1)).max() < 1e-6
    assert pinhole.depth_mm.shape == SIZE_PX[::-1]
    assert np.isnan(pinhole.depth_mm[pinhole.label == Label.NOTHING]).all()


def test_views_and_light_respect_the_shadows_of_a_box():
    here, there = station(), world(load(make_box([80, 60, 100])))
    truth = trace_core_truth(there, here)
    camera = here.rig.core_camera
    points = here.core_from_world.inverse().apply(
        np.concatenate([camera.rays() * truth.depth_mm[..., None], truth.depth_mm[..., None]], axis=-1)
    )
    x, y, z = np.moveaxis(points, -1, 0)
    flat = (truth.label == Label.BELT) & (np.abs(x) < 120) & (np.abs(y) < 28) & (np.abs(z) < 1e-6)
    for name, eye_x, eye_z in (("cam1", 240, 742), ("cam2", -240, 742)):
        # the box's top edge away from the eye throws its shadow that far
        side = -np.sign(eye_x)
        reach = side * 40 + (side * 40 - eye_x) * 100 / (eye_z - 100)
        hidden = (side * x > 40) & (side * x < side * reach)
        assert (flat & hidden).sum() > 10
        assert (flat & ~hidden).sum() > 100
        np.testing.assert_array_equal(truth.seen[name][flat], ~hidden[flat])
    shadow = (x > 40) & (x < 40 + 100 * 100 / 660) & flat  # the projector stands at x = -60, z = 760
    assert shadow.sum() > 3
    assert not truth.lit[shadow].any()
    assert truth.lit[flat & (x < -45)].all()
    np.testing.assert_array_equal(truth.views, truth.seen["cam1"].astype(int) + truth.seen["cam2"])
    assert not trace_core_truth(world(lit=False), here).lit.any()


def test_lit_area_ends_at_the_border_of_the_pattern():
    here = station()
    truth = trace_core_truth(world(), here)
    points = here.core_from_world.inverse().apply(
        np.concatenate([here.rig.core_camera.rays(), np.ones((*SIZE_PX[::-1], 1))], axis=-1)
        * truth.depth_mm[..., None]
    )
    flat = (truth.label == Label.BELT) & (np.abs(points[..., 0]) < 100)
    end = 30 / 75 * 760
    inside = np.abs(points[..., 1]) < end
    assert (flat & ~inside).any()
    np.testing.assert_array_equal(truth.lit[flat], inside[flat])


def test_measurable_shares_are_shares_of_the_region():
    truth = trace_core_truth(world(load(make_box([80, 60, 100]))), station())
    region = truth.label == Label.BELT
    shares = measurable_shares(truth, region)
    assert shares["pixels"] == region.sum()
    assert shares["seen_cam1"] == pytest.approx(truth.seen["cam1"][region].mean())
    assert shares["lit_and_seen_by_2"] == pytest.approx((truth.lit & (truth.views == 2))[region].mean())
    assert 0 < shares["lit_and_seen_by_2"] < shares["lit_and_seen_by_1"] < shares["seen_by_1"] <= 1
    assert measurable_shares(truth, np.zeros_like(region))["lit"] == 0


def test_rock_of_a_pixel_is_at_its_recorded_position():
    heap = make_heap(HeapSettings(rocks=150, seed=2), BELT)
    there = world(*heap.solids)
    truth = trace_core_view(there, station())
    rock = label_rocks(truth, there.solids, heap)
    assert ((rock >= 0) <= (truth.label == Label.MATERIAL)).all()
    camera, pose = station().rig.core_camera, station().core_from_world
    rows, columns = np.nonzero(rock >= 0)
    assert len(rows) > 300
    depth = truth.depth_mm[rows, columns, None]
    points = pose.inverse().apply(np.column_stack([camera.rays()[rows, columns] * depth, depth]))
    number = rock[rows, columns]
    away = np.linalg.norm(points - heap.rocks.center_mm[number], axis=1)
    assert (away < 1.3 * heap.rocks.size_mm[number]).all()


def test_volume_of_a_box_and_of_a_sphere_on_the_belt():
    cuboid = compute_true_load(world(load(make_box([80, 60, 50]))), (-60, 60), (-55, 55))
    assert cuboid.volume_mm3 == pytest.approx(80 * 60 * 50, rel=1e-9)
    assert cuboid.height_mm.max() == pytest.approx(50, abs=1e-9)
    # of a ball one sees the upper half from above; the rest counts as solid: a half ball on a cylinder
    sphere = make_sphere(40.0, 0.02)
    ball = compute_true_load(world(load(sphere, 3.3, -7.7, 40.0)), (-60, 60), (-55, 55))
    assert ball.volume_mm3 == pytest.approx(2 / 3 * np.pi * 40**3 + np.pi * 40**3, rel=1e-3)
    assert abs(ball.volume_mm3 - 5 / 3 * np.pi * 40**3) < ball.spread_mm3
    # a cap: the ball sunk into the belt down to 15 mm
    cap = compute_true_load(world(load(sphere, 3.3, -7.7, -25.0)), (-60, 60), (-55, 55))
    assert cap.volume_mm3 == pytest.approx(np.pi * 15**2 * (40 - 5), rel=1e-3)


def test_load_on_a_wing_is_measured_from_the_slope():
    slab = load(make_box([300, 100, 100]), 250.0)
    found = compute_true_load(world(slab), (-400, 400), (-80, 80), step_mm=0.5)
    x = np.linspace(100, BELT.half_width_mm[1], 200_001)
    expected = 100 * np.trapezoid(np.maximum(100 - BELT.height_at(x), 0) * (x <= 400), x)
    assert found.volume_mm3 == pytest.approx(expected, rel=1e-3)
    assert (found.height_mm[:, found.x_mm > BELT.half_width_mm[1]] == 0).all()  # beside the belt: not on it


def test_cross_sections_add_up_to_the_volume():
    there = world(load(make_box([80, 60, 50]), 10.0, 5.0), load(make_sphere(30.0, 0.02), -60.0, -20.0, 30.0))
    found = compute_true_load(there, (-100, 60), (-60, 40))
    step = found.y_mm[1] - found.y_mm[0]
    assert found.area_mm2.sum() * step == pytest.approx(found.volume_mm3, rel=1e-12)
    np.testing.assert_allclose(
        compute_true_area_mm2(there, np.array([30.0, -20.0, 70.0]), (-150, 150)),
        [80 * 50, 60 * 30 + np.pi * 450 + (80 * 50 if abs(-25) < 30 else 0), 0],
        rtol=1e-3, atol=1e-9,
    )  # fmt: skip


def test_ray_scene_may_be_shared():
    here, there = station(), world(load(make_box([80, 60, 50])))
    one, two = trace_core_truth(there, here), trace_core_truth(there, here, scene=RayScene(there.solids))
    np.testing.assert_array_equal(one.depth_mm, two.depth_mm)
