"""Poses of a simulated board: in view, tilted to all sides, spread over the image."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.simulate.rig_and_projector import make_station, sample_board_poses
from beltscape.simulate.scenario import BoardSpec, RigSpec
from beltscape.target.board import CharucoBoard, corner_points_mm

BOARD = CharucoBoard(squares=(11, 8), square_mm=34, marker_mm=25, dictionary="DICT_5X5_100")
CORNERS = corner_points_mm(BOARD)
MIDDLE = (CORNERS.min(axis=0) + CORNERS.max(axis=0)) / 2
STATION = make_station(RigSpec())
CORE = STATION.rig.core_camera


def draw_poses(count: int, seed: int = 1, **spec) -> list:
    """core_from_board of so many poses."""
    poses = sample_board_poses(BoardSpec(**spec), BOARD, STATION, count, seed)
    return [STATION.core_from_world @ pose for pose in poses]


@given(st.integers(0, 2**40), st.floats(0, 60), st.floats(0, 1))
def test_depth_and_tilt_of_the_centre_are_within_their_bounds(seed, tilt, reach):
    poses = draw_poses(24, seed, tilt_deg=tilt, reach=reach, depth_mm=(500, 700))
    middles = np.array([pose.apply(MIDDLE) for pose in poses])
    assert (middles[:, 2] >= 500 - 1e-9).all()
    assert (middles[:, 2] <= 700 + 1e-9).all()
    off = middles[:, :2] / middles[:, 2:] * CORE.focal_px / (np.array(CORE.size_px) / 2)
    assert (abs(off) <= reach + 1e-9).all()
    leans = np.rad2deg([np.arccos(np.clip(pose.rotation[2, 2], -1, 1)) for pose in poses])
    assert (leans <= tilt + 1e-5).all()  # z stays away from the camera: one sees its face


@pytest.mark.parametrize("seed", range(5))
def test_every_corner_is_in_front_of_every_camera(seed):
    for pose in sample_board_poses(BoardSpec(), BOARD, STATION, 24, seed):
        for name in STATION.rig.cameras:
            assert (STATION.cam_from_world(name) @ pose).apply(CORNERS)[:, 2].min() > 200


@pytest.mark.parametrize("seed", range(5))
def test_24_poses_are_spread_over_the_view(seed):
    poses = draw_poses(24, seed)
    middles = np.array([pose.apply(MIDDLE) for pose in poses])
    quadrant = (middles[:, 0] > 0) + 2 * (middles[:, 1] > 0)
    assert np.bincount(quadrant, minlength=4).min() >= 4
    thirds = np.histogram(middles[:, 2], bins=3, range=(560, 760))[0]
    assert thirds.min() >= 6
    normals = np.array([pose.rotation[:, 2] for pose in poses])
    sides = (normals[:, 0] > 0) + 2 * (normals[:, 1] > 0)
    assert np.bincount(sides, minlength=4).min() >= 3
    leans = np.rad2deg(np.arccos(normals[:, 2]))
    assert leans.max() > 20
    assert leans.min() < 15
    seen = np.array([CORE.project(pose.apply(CORNERS)) for pose in poses])
    inside = ((seen > 0) & (seen < np.array(CORE.size_px) - 1)).all(axis=-1)
    assert inside.mean() > 0.7
    cells = np.histogram2d(*seen[inside].T, bins=4, range=[(0, CORE.size_px[0]), (0, CORE.size_px[1])])[0]
    assert (cells > 0).all()


def test_same_seed_gives_the_same_poses_and_more_poses_are_appended():
    few, many, other = draw_poses(3), draw_poses(5), draw_poses(3, seed=2)
    for i in range(3):
        np.testing.assert_array_equal(few[i].rotation, many[i].rotation)
        np.testing.assert_array_equal(few[i].translation_mm, many[i].translation_mm)
        assert (few[i].translation_mm != other[i].translation_mm).all()
    assert draw_poses(0) == []


def test_a_board_that_faces_a_fisheye_lies_on_its_true_rays_at_its_depth():
    rig = RigSpec(focal_mm=4.5, scale=0.25, model="fisheye", distortion=(0.02, -0.01, 0.003, -0.001))
    station = make_station(rig)
    camera = station.rig.core_camera
    spec = BoardSpec(depth_mm=(260, 420), reach=0.75, faces_core=True)
    poses = [station.core_from_world @ pose for pose in sample_board_poses(spec, BOARD, station, 16, 1)]
    middles = np.array([pose.apply(MIDDLE) for pose in poses])
    distances = np.linalg.norm(middles, axis=1)
    assert ((distances > 260 - 1e-6) & (distances < 420 + 1e-6)).all()
    off = np.abs(camera.project(middles) - camera.center_px) / (np.array(camera.size_px) / 2)
    assert (off <= 0.75 + 1e-6).all()
    assert off.max() > 0.6
    rays = middles / distances[:, None]
    leans = [np.rad2deg(np.arccos(pose.rotation[:, 2] @ ray)) for pose, ray in zip(poses, rays, strict=True)]
    assert max(leans) <= spec.tilt_deg + 1e-5
