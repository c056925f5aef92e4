"""The temporal prior: the previous frame's surface, moved with the belt, where it was measured."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.stereo.multiview.initialisation.temporal_prior import Prior, predict_inverse_depth
from beltscape.stereo.multiview.initialisation.unmeasured_regions import find_unmeasured_blocks
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.multiview.settings import MultiviewSettings
from tests.stereo.scenes import (
    Scene,
    Solid,
    compute_depth_mm,
    make_ring,
    make_scene,
    mask_away_from_steps,
    mask_inner,
    patch,
    plane,
    prepare_scene,
    quantise,
    render_images,
    sphere,
)

SIZE_PX = (240, 200)
RIG = make_ring(size_px=SIZE_PX)
SHAPES = {
    "plane": (plane(700, 0.2, -0.1),),
    "sphere": (sphere(660, 400), plane(780)),
    "boxes": (plane(740), patch(660, (-150, 60), (-120, 120)), patch(690, (120, 200), (-60, 90))),
}
MOTIONS = {"along": (40.0, 0.0, 0.0), "across": (-25.0, 30.0, 0.0), "and nearer": (15.0, 10.0, -12.0)}


def displace(solids: tuple[Solid, ...], motion_mm) -> tuple[Solid, ...]:
    """Return displaced solids."""
    shift = np.asarray(motion_mm)
    return tuple(lambda origin, rays, solid=solid: solid(origin - shift, rays) for solid in solids)


def make_depth_map(depth: np.ndarray) -> DepthMap:
    """Return a depth map with this depth."""
    measured = np.isfinite(depth)
    sigma = np.where(measured, 0.1, np.nan).astype(np.float32)
    return DepthMap(depth.astype(np.float32), sigma, measured.astype(np.uint8), measured.astype(np.float32))


def make_prior(solids: tuple[Solid, ...], motion_mm, hole: tuple[slice, slice] | None = None) -> Prior:
    depth = compute_depth_mm(RIG, solids)
    if hole is not None:
        depth[hole] = np.nan
    return Prior(make_depth_map(depth), np.array(motion_mm, float))


def predict(prior: Prior, now: Scene) -> np.ndarray:
    return predict_inverse_depth(prior, now.prepared)


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("shape", SHAPES)
def test_the_prediction_is_the_inverse_depth_of_the_moved_scene(shape, motion):
    solids, motion_mm = SHAPES[shape], MOTIONS[motion]
    now = make_scene(*displace(solids, motion_mm), rig=RIG, noise=0.5)
    s = predict(make_prior(solids, motion_mm), now)
    finite = np.isfinite(s)
    assert finite.mean() > 0.9
    smooth = finite & mask_away_from_steps(now.s, 3)
    slope = cv2.dilate(np.abs(np.gradient(now.s.astype(float))).sum(axis=0), np.ones((3, 3)))
    gentle = smooth & (slope < 0.25)
    assert gentle.mean() > 0.7
    assert np.abs(s - now.s)[gentle].max() < 0.3
    assert np.median(np.abs(s - now.s)[gentle]) < 0.1
    nearer = (s - now.s)[smooth]  # the buffer holds the nearest of four pixels
    assert nearer.min() > -0.15
    assert (nearer - slope[smooth]).max() < 0.15


def test_prediction_without_motion_is_the_previous_surface():
    now = make_scene(*SHAPES["boxes"], rig=RIG, noise=0.5)
    s = predict(make_prior(SHAPES["boxes"], (0, 0, 0)), now)
    along = mask_away_from_steps(now.s, 2) & np.isfinite(s)
    assert along.mean() > 0.9
    np.testing.assert_allclose(s[along], now.s[along], atol=1e-3)


def test_prediction_on_a_coarser_grid_is_in_its_unit():
    solids, motion_mm = SHAPES["plane"], MOTIONS["along"]
    frames = FrameSet(
        "000", {n: quantise(i) for n, i in render_images(RIG, displace(solids, motion_mm)).items()}
    )
    prepared = prepare_scene(RIG, frames, step=2)
    unit = prepared.context.inverse_depth_scale
    s = predict_inverse_depth(make_prior(solids, motion_mm), prepared)
    true = 1 / (
        compute_depth_mm(RIG, displace(solids, motion_mm)).reshape(100, 2, 120, 2).mean(axis=(1, 3)) * unit
    )
    assert s.shape == (100, 120)
    assert np.isfinite(s).mean() > 0.85
    assert np.nanmax(np.abs(s - true)) < 0.3


@pytest.mark.parametrize("motion", MOTIONS)
def test_unmeasured_pixels_of_the_previous_frame_are_not_predicted(motion):
    """The hole moves with the scene; the margin is 1 px of the buffer and 2 px of rounding and tilt."""
    solids, motion_mm = SHAPES["plane"], np.array(MOTIONS[motion])
    hole = slice(70, 130), slice(80, 150)
    now = make_scene(*displace(solids, motion_mm), rig=RIG, noise=0.5)
    s = predict(make_prior(solids, motion_mm, hole), now)
    points = RIG.core_camera.rays() * compute_depth_mm(RIG, solids)[..., None] + motion_mm[:2]
    away = compute_depth_mm(RIG, solids) + motion_mm[2]
    at = points / away[..., None] * RIG.core_camera.focal_px + RIG.core_camera.center_px
    (top, left), (bottom, right) = (
        np.ceil(at[70, 80][::-1]).astype(int),
        np.floor(at[129, 149][::-1]).astype(int),
    )
    assert np.isnan(s[top + 3 : bottom - 3, left + 3 : right - 3]).all()
    around = mask_inner(s.shape, 24)
    around[top - 3 : bottom + 3, left - 3 : right + 3] = False
    assert np.isfinite(s[around]).mean() > 0.99


def test_prediction_from_a_frame_without_depth_is_empty():
    now = make_scene(*SHAPES["plane"], rig=RIG)
    assert np.isnan(predict(make_prior(SHAPES["plane"], (0, 0, 0), (slice(None), slice(None))), now)).all()


@pytest.mark.parametrize("wrong_mm", [60.0, 120.0, -60.0])
@pytest.mark.parametrize("shape", SHAPES)
def test_motion_wrong_by_several_pixels_is_mostly_rejected(shape, wrong_mm):
    """At 5 to 10 px the speckle agrees by chance in some places."""
    solids, motion_mm = SHAPES[shape], np.array(MOTIONS["along"])
    now = make_scene(*displace(solids, motion_mm), rig=RIG, noise=0.5)
    right = np.isfinite(predict(make_prior(solids, motion_mm), now)).mean()
    s = predict(make_prior(solids, motion_mm + np.array([0, 0, wrong_mm])), now)
    assert np.isfinite(s).mean() < 0.7 * right
    swept = np.zeros(s.shape, bool)
    for block in itertools.chain(*find_unmeasured_blocks(s, 2)):
        swept[block] = True
    assert swept.mean() > 0.8


@pytest.mark.parametrize("wrong_mm", [15.0, 30.0])
def test_motion_wrong_by_one_or_two_pixels_is_rejected(wrong_mm):
    solids, motion_mm = SHAPES["boxes"], np.array(MOTIONS["along"])
    now = make_scene(*displace(solids, motion_mm), rig=RIG, noise=0.5)
    s = predict(make_prior(solids, motion_mm + np.array([0, 0, wrong_mm])), now)
    assert np.isfinite(s).mean() < 0.3


@pytest.mark.parametrize("motion_mm", [(70.0, 0.0, 0.0), (-25.0, 30.0, 0.0), (15.0, 10.0, -12.0)])
@pytest.mark.parametrize("shape", SHAPES)
def test_depth_with_a_prior_is_as_accurate_as_without(shape, motion_mm):
    solids = SHAPES[shape]
    now = displace(solids, motion_mm)
    frames = FrameSet("000", {n: quantise(i) for n, i in render_images(RIG, now, noise=0.5).items()})
    truth = compute_depth_mm(RIG, now)
    matcher = MultiviewReconstructor(RIG, (600, 820), MultiviewSettings(threads=1))
    without = matcher.reconstruct(frames, Silent())
    with_prior = matcher.reconstruct(frames, Silent(), prior=make_prior(solids, motion_mm))

    def errors(depth: DepthMap) -> np.ndarray:
        return np.abs(depth.depth_mm - truth)[depth.measured]

    plain, better = errors(without), errors(with_prior)
    assert np.median(plain) < 0.15
    assert np.median(better) < np.median(plain) + 0.01
    assert (better < 1).sum() > 0.998 * (plain < 1).sum()
    assert (better > 5).mean() < (plain > 5).mean() + 0.001
    assert (with_prior.measured | ~without.measured).mean() > 0.998


def test_narrow_strip_that_came_into_view_is_measured():
    solids, motion_mm = SHAPES["plane"], MOTIONS["along"]
    now = displace(solids, motion_mm)
    frames = FrameSet("000", {n: quantise(i) for n, i in render_images(RIG, now, noise=0.5).items()})
    matcher = MultiviewReconstructor(RIG, (600, 820), MultiviewSettings(threads=1))
    without = matcher.reconstruct(frames, Silent())
    with_prior = matcher.reconstruct(frames, Silent(), prior=make_prior(solids, motion_mm))
    assert with_prior.measured[:, :12].mean() > 0.99 * without.measured[:, :12].mean()
