"""Rectification of pairs: equal rows, disparity range, maps and orientation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import ReconstructionError
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.stereo.pairwise.rectification import RectifiedPair, count_upright_turns, rectify_pair
from tests.stereo.raycast import make_camera, make_world_rig
from tests.strategies import seeds
from tests.thorough import examples

SMALL = (64, 52)


def draw_rig(seed: int, angle: float) -> Rig:
    """Return a core and a convergent auxiliary in any direction; both see depths of about 700 mm."""
    rng = np.random.default_rng(seed)
    baseline = rng.uniform(60, 250)
    center = np.array([baseline * np.cos(angle), baseline * np.sin(angle), rng.uniform(-40, 40)])
    turn = Pose.of([center[1] / 900, -center[0] / 900, rng.uniform(-0.1, 0.1)], np.zeros(3)).rotation
    poses = {"cam0": Pose.identity(), "cam1": Pose(turn, -turn @ center)}
    return Rig("cam0", {name: make_camera(name, SMALL) for name in poses}, poses)


def project_core(pair: RectifiedPair, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    seen = pair.rectified_from_core.apply(points)
    return seen[:, :2] / seen[:, 2:] * pair.focal_px + pair.core_center_px, seen[:, 2]


def project_aux(rig: Rig, pair: RectifiedPair, points: np.ndarray) -> np.ndarray:
    seen = pair.rectified_from_aux.apply(rig.cam_from_core[pair.auxiliary].apply(points))
    return seen[:, :2] / seen[:, 2:] * pair.focal_px + pair.aux_center_px


@given(seeds, st.floats(-np.pi, np.pi), st.floats(0.7, 2.0))
def test_points_lie_on_equal_rows_at_the_predicted_disparity(seed, angle, oversampling):
    rig = draw_rig(seed, angle)
    pair = rectify_pair(rig, "cam1", (600, 800), oversampling=oversampling)
    points = np.random.default_rng(seed).uniform([-200, -150, 600], [200, 150, 800], (50, 3))
    core, depth = project_core(pair, points)
    aux = project_aux(rig, pair, points)
    np.testing.assert_allclose(core[:, 1], aux[:, 1], atol=1e-6)
    np.testing.assert_allclose(core[:, 0] - aux[:, 0], pair.disparity_from_depth(depth), atol=1e-6)
    np.testing.assert_allclose(pair.depth_from_disparity(core[:, 0] - aux[:, 0]), depth, rtol=1e-9)


@given(seeds, st.floats(-np.pi, np.pi))
def test_the_disparity_range_covers_the_depth_range_and_starts_near_zero(seed, angle):
    rig = draw_rig(seed, angle)
    pair = rectify_pair(rig, "cam1", (600, 800))
    rays = rig.core_camera.rays().reshape(-1, 2)[::7]
    _, ratio = pair.project_core_rays(rays)
    far, near = pair.disparity_from_depth(800 * ratio), pair.disparity_from_depth(600 * ratio)
    assert 0 <= far.min() <= 2
    assert pair.disparities - 18 <= near.max() <= pair.disparities
    assert pair.disparities % 16 == 0


@given(seeds, st.floats(-np.pi, np.pi))
@examples(20)
def test_maps_give_the_distorted_pixel_of_the_same_point(seed, angle):
    rig = draw_rig(seed, angle)
    pair = rectify_pair(rig, "cam1", (600, 800))
    points = np.random.default_rng(seed).uniform([-120, -80, 650], [120, 80, 750], (40, 3))
    for name, rectified, source in (
        ("cam0", project_core(pair, points)[0], pair.core_map),
        ("cam1", project_aux(rig, pair, points), pair.aux_map),
    ):
        column, row = np.rint(rectified).astype(int).T
        inside = (column >= 0) & (column < pair.size_px[0]) & (row >= 0) & (row < pair.size_px[1])
        seen = rig.cameras[name].project(rig.cam_from_core[name].apply(points))
        inside &= (seen >= 0).all(axis=1) & (seen <= np.array(SMALL) - 1).all(axis=1)
        error = source[row[inside], column[inside]] - seen[inside]
        assert np.abs(error).max(initial=0) < 1.2  # the rounding to whole pixels of the map


def test_projected_core_rays_equal_projected_points():
    rig, _ = make_world_rig()
    pair = rectify_pair(rig, "cam2", (600, 800))
    points = np.random.default_rng(0).uniform([-200, -150, 600], [200, 150, 800], (50, 3))
    pixels, ratio = pair.project_core_rays(points[:, :2] / points[:, 2:])
    expected, depth = project_core(pair, points)
    np.testing.assert_allclose(pixels, expected, atol=1e-9)
    np.testing.assert_allclose(ratio * points[:, 2], depth, atol=1e-9)


@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
def test_the_core_keeps_its_optical_axis_as_far_as_the_baseline_allows(degrees):
    rig, _ = make_world_rig(angles_deg=(degrees,))
    pair = rectify_pair(rig, "cam1", (600, 800))
    baseline = rig.cam_from_core["cam1"].center_mm
    tilt = np.arccos(pair.rectified_from_core.rotation[2, 2])
    assert tilt == pytest.approx(abs(np.arcsin(baseline[2] / np.linalg.norm(baseline))), abs=1e-9)
    assert pair.rectified_from_core.rotation @ baseline == pytest.approx([pair.baseline_mm, 0, 0])


@pytest.mark.parametrize("degrees", [0, 90, 180, 270, 20, 110])
def test_images_are_upright_after_the_counted_turns(degrees):
    rig, _ = make_world_rig(angles_deg=(degrees,))
    pair = rectify_pair(rig, "cam1", (600, 800))
    u = np.rot90(pair.core_map[..., 0], count_upright_turns(pair))
    v = np.rot90(pair.core_map[..., 1], count_upright_turns(pair))
    middle = u.shape[0] // 2, u.shape[1] // 2
    assert u[middle[0], middle[1] + 20] - u[middle] > 10
    assert v[middle[0] + 20, middle[1]] - v[middle] > 10


def make_pair(center: list[float], turn: list[float]) -> Rig:
    rotation = Pose.of(turn, np.zeros(3)).rotation
    poses = {"cam0": Pose.identity(), "cam1": Pose(rotation, -rotation @ np.array(center))}
    return Rig("cam0", {name: make_camera(name, SMALL) for name in poses}, poses)


@pytest.mark.parametrize(
    ("rig", "depths", "message"),
    [
        (make_pair([100, 0, 0], [0, 0, 0]), (800, 600), "depth range 800 … 600 mm is empty"),
        (make_pair([0, 0, 0], [0, 0, 0]), (600, 800), "stand on one spot"),
        (make_pair([0, 0, 100], [0, 0, 0]), (600, 800), "stands on the optical axis of cam0"),
        (make_pair([100, 0, 0], [0, 0.9, 0]), (600, 800), "share no view between 600 and 800 mm"),
    ],
)
def test_error_names_why_a_pair_cannot_be_rectified(rig, depths, message):
    with pytest.raises(ReconstructionError, match=message):
        rectify_pair(rig, "cam1", depths)
