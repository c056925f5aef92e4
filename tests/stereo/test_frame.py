"""The prepared frame: core and auxiliaries agree on the true surface for every size of blocks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.core.frames import FrameSet
from beltscape.core.geometry.pose import Pose
from beltscape.kernels import load
from beltscape.stereo.multiview.frame import Noise, downsample
from beltscape.stereo.multiview.surface import compute_inverse_depth_scale
from tests.stereo.scenes import (
    DEPTH_MM,
    DOT_PX,
    cast_rays,
    compute_depth_mm,
    make_ring,
    mask_inner,
    plane,
    prepare_scene,
    quantise,
    render_images,
    sample_speckle,
)

SLANTED = (plane(DEPTH_MM, 0.25, -0.15),)


def prepare_plane(step: int, size_px: tuple[int, int], noise: float = 0.0):
    rig = make_ring(size_px=size_px)
    images = render_images(rig, SLANTED, noise=noise, dot_px=DOT_PX * step)
    frame_set = FrameSet("000", {name: quantise(image) for name, image in images.items()})
    s = 1 / (compute_depth_mm(rig, SLANTED) * compute_inverse_depth_scale(rig, rig.auxiliaries, step))
    return prepare_scene(rig, frame_set, step=step), downsample(s.astype(np.float32), step)


def compute_misfit(prepared, s: np.ndarray, i: int) -> float:
    """Return the mean squared difference of the core's levels and auxiliary i's warped by s, levels²."""
    value, _ = load().warp(s.astype(np.float32), prepared.views[i], prepared.coefficients[i], threads=1)
    return float(np.nanmean(((value - prepared.core) ** 2)[mask_inner(s.shape, 4)]))


@pytest.mark.parametrize(("step", "size_px"), [(1, (121, 99)), (2, (243, 201)), (4, (403, 322))])
def test_the_auxiliaries_agree_with_the_core_on_the_true_surface(step, size_px):
    prepared, s = prepare_plane(step, size_px)
    shape = size_px[1] // step, size_px[0] // step
    assert prepared.core.shape == s.shape == shape
    assert {image.shape for image in prepared.images} == {shape}
    contrast = np.nanvar(prepared.core)
    for i in range(4):
        before, there, beyond = (compute_misfit(prepared, s + ds, i) for ds in (-0.25, 0, 0.25))
        assert there < 0.02 * contrast
        assert compute_misfit(prepared, s + 3, i) > 40 * there
        vertex_px = 0.125 * (before - beyond) / (before - 2 * there + beyond)
        assert abs(vertex_px) < 0.02


def test_core_is_undistorted_and_nan_outside_its_view():
    rig = make_ring(())
    distorted = replace(rig.core_camera, distortion=np.array([0.35, 0, 0, 0, 0]))  # its corners lie outside
    rig = replace(make_ring((0,)), cameras={"cam0": distorted, "cam1": distorted})
    images = render_images(rig, SLANTED)
    prepared = prepare_scene(rig, FrameSet("000", {n: quantise(i) for n, i in images.items()}), ("cam1",))
    dot_mm = DOT_PX * DEPTH_MM / distorted.focal_px[0]
    straight = sample_speckle(cast_rays(distorted, Pose.identity(), SLANTED, distorted.rays()), dot_mm)
    inside = np.isfinite(prepared.core)
    assert not inside[[0, 0, -1, -1], [0, -1, 0, -1]].any()
    assert inside[20:-20, 20:-20].all()
    assert np.sqrt(np.mean((prepared.core - straight)[inside] ** 2)) < 0.05 * straight.std()


@pytest.mark.parametrize("step", [1, 2])
def test_noise_is_that_of_the_averaged_levels(step):
    rig = make_ring((0,))
    rng = np.random.default_rng(1)
    even = FrameSet("000", {n: quantise(90 + rng.normal(0, 4, (100, 120))) for n in rig.cameras})
    prepared = prepare_scene(rig, even, ("cam1",), step)
    assert prepared.noise.levels == pytest.approx(np.nanvar(prepared.images[0]), rel=0.25)


def test_strong_texture_raises_the_floor_under_weak_texture():
    noise = prepare_plane(1, (121, 99), noise=2.0)[0].noise
    assert 200 < noise.texture < 4000
    assert Noise(noise.levels, noise.model, 4 * noise.texture).floor > noise.floor > 2 * noise.levels


def test_blocks_are_means_of_whole_blocks():
    level = np.arange(35, dtype=np.float32).reshape(5, 7)
    found = downsample(level, 2)
    np.testing.assert_allclose(found, level[:4, :6].reshape(2, 2, 3, 2).mean(axis=(1, 3)))
    np.testing.assert_array_equal(downsample(level, 1), level)
