"""Poses and lenses of the simulated cameras and the projector."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import InputError
from beltscape.core.geometry.rig import scale_camera
from beltscape.files.rig_json import write_rig
from beltscape.simulate.rig_and_projector import make_projector, make_station
from beltscape.simulate.scenario import ProjectorSpec, RigSpec
from beltscape.target.pattern import PatternSettings, make_pattern
from beltscape.target.pattern_formats import write_pattern
from tests.strategies import cameras

DRAWN = RigSpec(scatter=0.0, scale=1.0)


@given(st.integers(1, 6), st.floats(0, 600), st.floats(-180, 180), st.floats(-100, 300), st.floats(400, 2000))
def test_nominal_cameras_are_aimed_at_one_point_with_rows_across(count, baseline, first, aim, height):
    baseline = max(baseline, 1e-3)
    spec = DRAWN.model_copy(
        update={
            "auxiliaries": count,
            "baseline_mm": baseline,
            "first_deg": first,
            "aim_mm": aim,
            "height_mm": height,
        }
    )
    stands = make_station(spec)
    assert list(stands.rig.cameras) == [f"cam{i}" for i in range(count + 1)]
    assert stands.rig.core == "cam0"
    for i, name in enumerate(stands.rig.cameras):
        pose = stands.cam_from_world(name)
        seen = pose.apply(np.array([0.0, 0.0, aim]))
        np.testing.assert_allclose(seen[:2], 0, atol=1e-9)
        assert seen[2] > 0
        angle = np.deg2rad(first) + 2 * np.pi * (i - 1) / count
        place = np.array([0, 0, height]) + (i > 0) * baseline * np.array([np.cos(angle), np.sin(angle), 0])
        np.testing.assert_allclose(pose.center_mm, place, atol=1e-9)
        assert pose.rotation[0, 0] > 0  # columns run across the belt …
        if baseline < height - aim:
            assert pose.rotation[1, 1] < 0  # … and rows against its motion


@given(st.floats(-180, 180), st.floats(10, 360), st.integers(1, 4))
def test_a_turned_rig_keeps_its_shape_and_its_place(yaw, around, count):
    spec = DRAWN.model_copy(update={"auxiliaries": count, "around_deg": around})
    before, after = make_station(spec), make_station(spec.model_copy(update={"yaw_deg": yaw}))
    across, along = np.cos(np.deg2rad(yaw)), np.sin(np.deg2rad(yaw))
    turn = np.array([[across, -along, 0], [along, across, 0], [0, 0, 1]])
    for name in before.rig.cameras:
        np.testing.assert_allclose(
            after.cam_from_world(name).center_mm, turn @ before.cam_from_world(name).center_mm, atol=1e-9
        )
        for each in ("rotation", "translation_mm"):
            same = [getattr(stands.rig.cam_from_core[name], each) for stands in (before, after)]
            np.testing.assert_allclose(*same, atol=1e-9)


def test_two_auxiliaries_in_180_degrees_form_an_l():
    stands = make_station(DRAWN.model_copy(update={"auxiliaries": 2, "around_deg": 180.0}))
    places = [stands.cam_from_world(name).center_mm[:2] for name in ("cam1", "cam2")]
    np.testing.assert_allclose(places, [[300, 0], [0, 300]], atol=1e-9)


def test_camera_rotates_by_the_shortest_way():
    stands = make_station(DRAWN)
    down = np.diag([1.0, -1.0, -1.0])
    np.testing.assert_array_equal(stands.core_from_world.rotation, down)
    for name in ("cam1", "cam2", "cam3", "cam4"):
        rotation = stands.cam_from_world(name).rotation
        shortest = np.arccos(-rotation[2] @ [0, 0, 1])
        turned = np.arccos((np.trace(down.T @ rotation) - 1) / 2)
        assert turned == pytest.approx(shortest, abs=1e-9)
        assert shortest == pytest.approx(np.arctan2(300, 744 - 60))


def test_lenses_without_scatter_are_nominal():
    for camera in make_station(DRAWN).rig.cameras.values():
        assert camera.size_px == (2448, 2048)
        np.testing.assert_array_equal(camera.focal_px, 8000 / 3.45)
        np.testing.assert_array_equal(camera.center_px, [1223.5, 1023.5])
        np.testing.assert_array_equal(camera.distortion, DRAWN.distortion)


def test_scatter_has_the_stated_standard_deviations():
    made = [make_station(RigSpec(auxiliaries=16, scale=1.0, seed=seed)) for seed in range(12)]
    lenses = [camera for stands in made for camera in stands.rig.cameras.values()]
    focal = np.array([camera.focal_px[0] for camera in lenses]) / (8000 / 3.45)
    assert focal.mean() == pytest.approx(1, abs=0.001)
    assert focal.std() == pytest.approx(0.004, rel=0.2)
    center = np.array([camera.center_px for camera in lenses]) - [1223.5, 1023.5]
    np.testing.assert_allclose(center.std(axis=0), 24.48, rtol=0.2)
    drawn = make_station(RigSpec(auxiliaries=16, scatter=0.0))
    off = [
        stands.cam_from_world(name).center_mm - drawn.cam_from_world(name).center_mm
        for stands in made
        for name in stands.rig.cameras
    ]
    np.testing.assert_allclose(np.std(off, axis=0), 5, rtol=0.2)
    turn = [stands.core_from_world.rotation @ np.diag([1, -1, -1]) for stands in made]
    angles = [np.rad2deg(np.arccos((np.trace(r) - 1) / 2)) for r in turn]
    assert 0.3 < np.mean(angles) < 2.4  # 0.7° about each of three axes


def test_seed_determines_the_plant():
    first, again, other = make_station(RigSpec()), make_station(RigSpec()), make_station(RigSpec(seed=2))
    for name, camera in first.rig.cameras.items():
        np.testing.assert_array_equal(camera.focal_px, again.rig.cameras[name].focal_px)
        np.testing.assert_array_equal(
            first.cam_from_world(name).rotation, again.cam_from_world(name).rotation
        )
        assert (camera.focal_px != other.rig.cameras[name].focal_px).all()
        assert (first.cam_from_world(name).center_mm != other.cam_from_world(name).center_mm).all()


@given(cameras(), st.sampled_from([1.0, 0.5, 0.25, 0.37]))
def test_scaled_pixels_are_merged_original_pixels(camera, scale):
    small = scale_camera(camera, scale)
    np.testing.assert_allclose(small.size_px, scale * np.array(camera.size_px), atol=0.5)
    factor = np.array(small.size_px) / camera.size_px
    points = np.array([[0.0, 0.0, 700.0], [120.0, -80.0, 650.0], [-90.0, 140.0, 900.0]])
    np.testing.assert_allclose(
        small.project(points), (camera.project(points) + 0.5) * factor - 0.5, rtol=0, atol=1e-9
    )


def test_given_rig_is_used_unchanged(tmp_path):
    drawn = make_station(RigSpec(scale=1.0, auxiliaries=2, seed=7)).rig
    write_rig(tmp_path / "rig.json", drawn)
    stands = make_station(RigSpec(file=tmp_path / "rig.json", scale=1.0, height_mm=900))
    assert stands.rig.core == drawn.core
    for name, camera in drawn.cameras.items():
        own = stands.rig.cameras[name]
        assert own.size_px == camera.size_px
        for values in ("focal_px", "center_px", "distortion"):
            np.testing.assert_array_equal(getattr(own, values), getattr(camera, values))
        np.testing.assert_array_equal(
            stands.rig.cam_from_core[name].rotation, drawn.cam_from_core[name].rotation
        )
    np.testing.assert_allclose(stands.core_from_world.center_mm, [0, 0, 900])
    half = make_station(RigSpec(file=tmp_path / "rig.json", scale=0.5))
    assert half.rig.core_camera.size_px == (1224, 1024)


def test_missing_rig_file_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"gone\.json: no such file"):
        make_station(RigSpec(file=tmp_path / "gone.json"))


SMALL = ProjectorSpec(size_px=(320, 200))


def test_projector_is_aimed_at_the_origin_and_covers_its_width():
    made = make_projector(SMALL)
    pose, lens = made.projector_from_world, made.camera
    np.testing.assert_allclose(lens.project(pose.apply(np.zeros(3))), [159.5, 99.5], atol=1e-9)
    np.testing.assert_allclose(pose.center_mm, SMALL.position_mm, atol=1e-9)
    rays = np.array([[(x - 159.5) / lens.focal_px[0], 0.0, 1.0] for x in (-0.5, 319.5)]) @ pose.rotation
    left, right = (pose.center_mm - ray * pose.center_mm[2] / ray[2] for ray in rays)
    assert right[0] - left[0] == pytest.approx(960, rel=0.01)


def test_projector_light_follows_the_pattern():
    sharp = make_projector(SMALL.model_copy(update={"blur_px": 0.0, "gamma": 1.0}))
    assert sharp.pattern.shape == (200, 320, 3)
    assert sharp.pattern.dtype == np.float32
    assert 0 <= sharp.pattern.min() < sharp.pattern.max() <= 1
    steep = make_projector(SMALL.model_copy(update={"blur_px": 0.0, "gamma": 2.0}))
    np.testing.assert_allclose(steep.pattern, sharp.pattern**2, atol=1e-6)
    soft = make_projector(SMALL.model_copy(update={"gamma": 1.0}))
    assert soft.pattern.std() < sharp.pattern.std()
    inside = (slice(10, -10), slice(10, -10))
    assert soft.pattern[inside].mean() == pytest.approx(sharp.pattern[inside].mean(), rel=0.03)


def test_projector_seed_changes_the_dots():
    first, again = make_projector(SMALL).pattern, make_projector(SMALL).pattern
    np.testing.assert_array_equal(first, again)
    assert (first != make_projector(SMALL.model_copy(update={"seed": 2})).pattern).any()


def test_given_pattern_must_have_the_size_of_the_projector(tmp_path):
    own = tmp_path / "pattern.json"
    write_pattern(own, make_pattern(PatternSettings(size_px=(320, 200), count=500, seed=3)))
    assert make_projector(SMALL.model_copy(update={"pattern": own})).pattern.mean() > 0
    with pytest.raises(
        InputError, match=r"320×200 px, the projector 1920×1200; set projector\.size_px"
    ) as said:
        make_projector(ProjectorSpec(pattern=own))
    assert str(said.value).startswith(str(own))
