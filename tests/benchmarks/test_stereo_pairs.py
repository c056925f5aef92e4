"""Scores of stereo pairs, tested on scenes made by formulas."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy import ndimage

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from stereo_pairs.disparity_pair import DisparityPair
from stereo_pairs.speckle_pair import SpecklePair, triangulate_depth_mm
from stereo_pairs.subsets import find_subsets, fit_auxiliary_pose

LENS = np.array([-0.1, 0.05, 1e-3, -5e-4, 0.02])
POSE = Pose.of([0.02, -0.15, 0.01], [-100.0, 3.0, 8.0])
CAMERAS = {
    "a": Camera("a", (320, 240), np.array([400.0, 401]), np.array([158.0, 121]), LENS),
    "b": Camera("b", (320, 240), np.array([390.0, 392]), np.array([162.0, 117]), -LENS),
}
RIG = Rig("a", CAMERAS, {"a": Pose.identity(), "b": POSE})


def tilted(rays: np.ndarray) -> np.ndarray:
    """Depth of a tilted plane at rays (..., 2)."""
    return 600 / (1 + 0.3 * rays[..., 0] - 0.2 * rays[..., 1])


def depth_map(depth_mm: np.ndarray) -> DepthMap:
    measured = np.isfinite(depth_mm)
    ones = np.ones(depth_mm.shape, np.float32)
    return DepthMap(depth_mm.astype(np.float32), ones, measured.astype(np.uint8), measured.astype(np.float32))


@pytest.fixture
def pair() -> SpecklePair:
    u, v = np.meshgrid(np.linspace(40, 280, 9), np.linspace(30, 210, 7))
    core_px = np.column_stack([u.ravel(), v.ravel()])
    rays = CAMERAS["a"].undistort(core_px)
    points = np.column_stack([rays, np.ones(len(rays))]) * tilted(rays)[:, None]
    aux_px = CAMERAS["b"].project(POSE.apply(points))
    return SpecklePair("plane", RIG, FrameSet("0", {}), (500.0, 750.0), core_px, aux_px)


@pytest.mark.parametrize("subset_px", [1, 9])
def test_the_true_depth_agrees_through_both_lenses(pair, subset_px):
    agreement = pair.compare(depth_map(tilted(CAMERAS["a"].rays())), subset_px=subset_px)
    assert agreement.points == 63
    assert agreement.measured == 1
    np.testing.assert_allclose(agreement.along_px, 0, atol=2e-3)  # float32 and straight lines between pixels
    np.testing.assert_allclose(pair.epipolar_px(), 0, atol=1e-9)


def test_a_nearer_surface_differs_by_its_disparity(pair):
    true = tilted(CAMERAS["a"].rays())
    nearer = pair.compare(depth_map(true / (1 + 1e-3))).along_px
    # baseline 100 mm, focal length 390 px: 1e-3 of the disparity
    expected = 1e-3 * 390 * 100 / pair.reference_depth_mm()
    np.testing.assert_allclose(nearer, expected, rtol=0.15)


def test_gaps_and_gross_errors_are_counted(pair):
    depth_mm = tilted(CAMERAS["a"].rays())
    depth_mm[:, :160] = np.nan
    depth_mm[120:] *= 0.9
    agreement = pair.compare(depth_map(depth_mm))
    assert agreement.measured == pytest.approx(np.isfinite(agreement.along_px).mean())
    assert 0.4 < agreement.measured < 0.6
    assert 0.4 < agreement.gross < 0.6


def test_across_the_line_is_the_calibrations_error_and_along_the_matchers(pair):
    rays = CAMERAS["a"].undistort(pair.core_px)
    away = replace(pair, aux_px=pair.aux_px + np.array([0.0, 0.3]))  # the baseline lies along u
    assert np.abs(np.abs(away.epipolar_px()) - 0.3).max() < 0.03
    along = away.compare(depth_map(tilted(CAMERAS["a"].rays()))).along_px
    assert np.abs(along).max() < 0.06
    np.testing.assert_allclose(
        triangulate_depth_mm(RIG, pair.core_px, pair.aux_px, 700.0), tilted(rays), rtol=1e-9
    )


def test_pose_fit_recovers_a_rotated_camera(pair):
    moved = Pose.of([0.004, -0.02, 0.003], [0.0, 0.0, 0.0]) @ POSE
    # two planes: one alone does not tell turn from shift well
    rays = CAMERAS["a"].undistort(pair.core_px)
    deeper = np.column_stack([rays, np.ones(len(rays))]) * (1.3 * tilted(rays))[:, None]
    core_px = np.concatenate([pair.core_px, pair.core_px])
    aux_px = np.concatenate([pair.aux_px, CAMERAS["b"].project(POSE.apply(deeper))])
    aux_px[5, 1] += 8.0  # a false match
    found = fit_auxiliary_pose(
        replace(RIG, cam_from_core={"a": Pose.identity(), "b": moved}), core_px, aux_px
    )
    back = found.cam_from_core["b"]
    assert (back @ POSE.inverse()).angle_deg < 0.01
    np.testing.assert_allclose(back.translation_mm, POSE.translation_mm, atol=0.1)


def test_subsets_are_found_to_a_hundredth_of_a_pixel():
    rng = np.random.default_rng(4)
    fine = cv2.GaussianBlur(rng.normal(size=(200, 240)).astype(np.float32), (0, 0), 2.0)
    left = np.clip(128 + 300 * fine, 0, 255)
    warp = np.array([[1.01, 0.02, 6.3], [-0.01, 0.99, 2.6]])
    back = np.linalg.inv(np.vstack([warp, [0, 0, 1]]))
    u, v = np.meshgrid(np.arange(240.0), np.arange(200.0))
    u, v = np.tensordot(back[:2], np.stack([u, v, np.ones_like(u)]), axes=1)
    right = ndimage.map_coordinates(left, np.stack([v, u]), order=3)
    core_px = np.array([[60.0, 60], [100, 90], [150, 120], [3, 3]])
    core, aux = (np.rint(np.clip(image, 0, 255)).astype(np.uint8) for image in (left, right))
    found, score = find_subsets(core, aux, core_px, core_px, subset_px=27, reach_px=(15, 10))
    expected = np.column_stack([core_px, np.ones(4)]) @ warp.T
    assert np.abs(found[:3] - expected[:3]).max() < 0.02
    assert (score[:3] > 0.98).all()
    assert np.isnan(found[3]).all()  # leaves the image
    assert np.isnan(score[3])


@pytest.fixture
def steps() -> DisparityPair:
    """A wall of disparity 4, a post of 10 before it, and a column whose truth is not known."""
    focal = np.full(2, 100.0)
    cameras = {
        "l": Camera("l", (40, 6), focal, np.array([20.0, 3]), np.zeros(5)),
        "r": Camera("r", (40, 6), focal, np.array([22.0, 3]), np.zeros(5)),
    }
    rig = Rig("l", cameras, {"l": Pose.identity(), "r": Pose.of(np.zeros(3), [-50.0, 0, 0])})
    disparity = np.full((6, 40), 4.0)
    disparity[:, 20:24] = 10
    disparity[:, 39] = np.nan
    return DisparityPair("steps", rig, FrameSet("0", {}), (300.0, 1000.0), disparity)


def test_depth_becomes_the_disparity_that_the_cameras_see(steps):
    core, aux = (steps.rig.cameras[name] for name in "lr")
    depth = depth_map(np.full((6, 40), 500.0))
    points = depth.points_mm(core)
    moved = core.project(points)[..., 0] - aux.project(steps.rig.cam_from_core["r"].apply(points))[..., 0]
    np.testing.assert_allclose(steps.disparity_from_depth(depth), moved)
    assert moved[0, 0] == pytest.approx(100 * 50 / 500 - 2)


def test_every_share_counts_what_it_says_in_px(steps):
    off = np.zeros((6, 40))
    off[1], off[2], off[3], off[4] = 0.7, 1.5, 9.0, np.nan
    depth = depth_map(100 * 50 / (steps.disparity_px + off + 2))
    score = steps.score(depth)
    assert score.pixels == 6 * 39
    assert score.coverage == pytest.approx(5 / 6)
    assert score.within_half_px == pytest.approx(2 / 6)
    assert score.within_1px == pytest.approx(3 / 6)
    assert score.within_2px == pytest.approx(4 / 6)
    assert score.gross == pytest.approx(1 / 5)
    assert score.median_px == pytest.approx(0.7, abs=1e-4)
    region = np.zeros((6, 40), bool)
    region[0] = True
    assert steps.score(depth, region).within_half_px == 1


def test_occluded_and_outside_pixels_are_not_covisible(steps):
    seen = steps.covisible_mask()[0]
    hidden = np.flatnonzero(~seen)
    # wall at u is hidden where u - 4 = post's u' - 10, u' = 20…23; u < 4 leaves the right image
    assert hidden.tolist() == [0, 1, 2, 3, 14, 15, 16, 17, 39]


def test_another_grid_is_refused(steps):
    with pytest.raises(InputError, match="truth is"):
        steps.score(depth_map(np.ones((3, 3))))
