"""Geometry of a planned rig: poses, footprints and overlaps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import InputError
from beltscape.plan.coverage import (
    area_mm2,
    clip,
    clip_to_strip,
    compute_coverage,
    compute_plane_coverage,
    overlap_shares,
    project_footprint,
)
from beltscape.plan.planned_rig import make_planned_rig, predict_sigma_mm, projection_jacobian
from beltscape.plan.settings import CameraSettings, PlanSettings, RigSettings
from tests.thorough import examples


@st.composite
def plans(draw):
    plan = PlanSettings(
        camera=CameraSettings(focal_mm=draw(st.floats(6, 16))),
        rig=RigSettings(auxiliaries=draw(st.integers(1, 6)), first_deg=draw(st.floats(-180, 180))),
    )
    return plan, make_planned_rig(plan, draw(st.floats(700, 2000)), draw(st.floats(50, 350)))


@given(plans())
def test_cameras_stand_around_the_core_aimed_at_one_point(drawn):
    plan, planned = drawn
    positions = np.array([planned.position_mm(name) for name in planned.rig.cameras])
    around = positions[1:, :2] - positions[0, :2]
    np.testing.assert_allclose(np.linalg.norm(around, axis=1), planned.baseline_mm, rtol=1e-9)
    np.testing.assert_allclose(positions[:, 2], planned.core_from_world.center_mm[2])
    angles = np.deg2rad(plan.rig.first_deg) + np.arange(len(around)) * 2 * np.pi / len(around)
    expected = planned.baseline_mm * np.column_stack([np.cos(angles), np.sin(angles)])
    np.testing.assert_allclose(around, expected, atol=1e-9)
    for name, camera in planned.rig.cameras.items():
        np.testing.assert_allclose(planned.project(name, planned.target_mm), camera.center_px, atol=1e-6)
        across = planned.cam_from_world(name).rotation @ [1, 0, 0]
        assert across[0] > 0.8  # every image is the same way up


@given(plans(), st.floats(0, 150))
def test_footprint_projects_to_the_border_of_the_image(drawn, height):
    _, planned = drawn
    for name, camera in planned.rig.cameras.items():
        try:
            polygon = project_footprint(planned, name, height)
        except InputError:
            continue
        corners = np.column_stack([polygon, np.full(4, height)])
        pixels = planned.project(name, corners)
        width, tall = camera.size_px
        rim = {(-0.5, -0.5), (-0.5, tall - 0.5), (width - 0.5, tall - 0.5), (width - 0.5, -0.5)}
        assert {tuple(p) for p in np.round(pixels, 5)} == rim
        assert area_mm2(polygon) > 0


def test_camera_that_sees_the_horizon_is_refused():
    with pytest.raises(InputError, match=r"baseline_mm = 2000: cam1 would be tilted by 66\.7°"):
        project_footprint(make_planned_rig(PlanSettings(), 938, 2000), "cam1", 0.0)


def regular(corners: int, radius: float, center: tuple[float, float], turn: float) -> np.ndarray:
    angle = turn + np.arange(corners) / corners * 2 * np.pi
    return np.column_stack([np.cos(angle), np.sin(angle)]) * radius + center


shapes = st.builds(
    regular, st.integers(3, 8), st.floats(20, 100), st.tuples(st.floats(-60, 60), st.floats(-60, 60)), st.floats(0, 6)
)  # fmt: skip


@given(shapes, shapes)
def test_clipping_is_symmetric_and_within(a, b):
    first, second = area_mm2(clip(a, b)), area_mm2(clip(b, a))
    assert first == pytest.approx(second, abs=1e-6)
    assert first <= min(area_mm2(a), area_mm2(b)) + 1e-6


@examples(20)
@given(shapes, st.lists(shapes, min_size=1, max_size=4))
def test_overlap_agrees_with_counted_cells(base, others):
    def inside(polygon, points):
        ends = np.roll(polygon, -1, axis=0)
        edge, to = ends - polygon, points[:, None] - polygon
        return (edge[:, 0] * to[..., 1] - edge[:, 1] * to[..., 0] >= 0).all(axis=1)

    grid = np.stack(np.meshgrid(*[np.linspace(-165, 165, 400)] * 2), axis=-1).reshape(-1, 2)
    grid = grid[inside(base, grid)]
    seen = np.sum([inside(other, grid) for other in others], axis=0)
    counted = [(seen >= k).mean() for k in range(len(others) + 1)]
    np.testing.assert_allclose(overlap_shares(base, others), counted, atol=0.03)


def test_core_length_equals_the_length_of_its_footprint():
    plan = PlanSettings()
    planned = make_planned_rig(plan, 900.0, 300.0)
    belt, *_ = compute_coverage(plan, planned)
    assert belt.core_length_mm == pytest.approx(2048 * 900 / plan.camera.focal_px, abs=0.01)
    assert belt.pixel_mm["cam0"] == pytest.approx([900 / plan.camera.focal_px] * 3)
    assert list(belt.lengths_mm) == sorted(belt.lengths_mm, reverse=True)
    assert belt.at_least[0] == pytest.approx(1)
    seen = clip_to_strip(300, belt.polygons["cam0"])
    assert belt.at_least[-1] == pytest.approx(area_mm2(clip(belt.all_cameras, seen)) / area_mm2(seen))


def test_width_that_the_core_does_not_see_has_no_length():
    assert (
        compute_plane_coverage(
            make_planned_rig(PlanSettings(), 900.0, 300.0), "wide", 0.0, 1500.0
        ).lengths_mm[0]
        == 0
    )


@given(plans())
def test_jacobian_is_the_derivative_of_the_projection(drawn):
    _, planned = drawn
    points = np.array([[10.0, -40.0, 20.0], [-150.0, 60.0, 100.0]])
    for name, camera in planned.rig.cameras.items():
        slope = projection_jacobian(camera, planned.cam_from_world(name), points)
        step = np.eye(3) * 1e-3
        for axis in range(3):
            ahead, behind = (
                planned.project(name, points + step[axis]),
                planned.project(name, points - step[axis]),
            )
            np.testing.assert_allclose(slope[..., axis], (ahead - behind) / 2e-3, atol=1e-5)


@pytest.mark.parametrize("auxiliaries", [1, 2, 4])
def test_sigma_equals_the_scatter_of_triangulated_noisy_pixels(auxiliaries):
    plan = PlanSettings(rig=RigSettings(auxiliaries=auxiliaries))
    planned = make_planned_rig(plan, 850.0, 260.0)
    rig, noise, runs = planned.rig, 0.3, 3000
    points = np.array([[0.0, 0.0, 75.0], [250.0, -180.0, 0.0], [-330.0, 120.0, 120.0]])
    predicted = predict_sigma_mm(planned, points, noise)
    rng = np.random.default_rng(3)
    in_core = planned.core_from_world.apply(points)
    projections = np.array([rig.projection(name) for name in rig.cameras])
    exact = np.array([planned.project(name, points) for name in rig.cameras])
    noisy = np.repeat(exact, runs, axis=1) + rng.normal(0, noise, (len(exact), len(points) * runs, 2))
    seen = np.array([planned.sees(name, points) for name in rig.cameras])
    noisy[~np.repeat(seen, runs, axis=1)] = np.nan
    depth = triangulate(projections, noisy)[:, 2].reshape(len(points), runs)
    np.testing.assert_allclose(depth.mean(axis=1), in_core[:, 2], atol=0.05)
    np.testing.assert_allclose(depth.std(axis=1), predicted, rtol=0.05)


def triangulate(projections, pixels):
    from beltscape.kernels import load

    return load().triangulate(projections, pixels, threads=1)


def test_sigma_is_nan_where_core_or_all_auxiliaries_do_not_see():
    planned = make_planned_rig(PlanSettings(), 850.0, 260.0)
    outside = np.array([[700.0, 0.0, 0.0], [0.0, 3000.0, 0.0]])
    assert np.isnan(predict_sigma_mm(planned, outside, 0.1)).all()


def test_calibration_adds_in_quadrature_and_noise_in_proportion():
    planned = make_planned_rig(PlanSettings(), 850.0, 260.0)
    spot = np.array([[20.0, 30.0, 40.0]])
    one = predict_sigma_mm(planned, spot, 0.1)
    np.testing.assert_allclose(predict_sigma_mm(planned, spot, 0.2), 2 * one)
    np.testing.assert_allclose(predict_sigma_mm(planned, spot, 0.1, 0.5), np.hypot(one, 0.5))
