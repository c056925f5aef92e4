"""Triangulation: each level agrees with the reference, on rigs and views of every shape."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import KernelError
from beltscape.core.geometry.rig import Rig
from beltscape.kernels import load
from beltscape.kernels.native import levels
from tests.strategies import looking_rigs, seeds

COUNTS = (0, 1, 2, 3, 4, 5, 7, 8, 9, 15, 16, 17, 31)
"""Full lanes, none, and every kind of tail for 2, 4 and 8 of them."""

every_level = pytest.mark.parametrize("level", levels())
everything = pytest.mark.parametrize("name", ["reference", *levels()])


def scene(rig: Rig, count: int, seed: int, noise_px: float = 0.0, unseen: float = 0.0):
    """Projections (n, 3, 4), pixels (n, N, 2) with a share of views taken away, and the points (N, 3)."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-200, -200, 800], [200, 200, 1200], (count, 3))
    projections = np.stack([rig.projection(name) for name in rig.cameras])
    homogeneous = np.concatenate([points, np.ones((count, 1))], axis=1) @ np.swapaxes(projections, 1, 2)
    pixels = homogeneous[..., :2] / homogeneous[..., 2:]
    pixels += rng.normal(0, noise_px, pixels.shape)
    taken = rng.random(pixels.shape[:2]) < unseen
    pixels[taken] = np.nan
    half = rng.random(pixels.shape[:2]) < unseen / 4  # one coordinate missing is not seen either
    pixels[half, rng.integers(0, 2)] = np.nan
    return projections, pixels, points


@every_level
@given(looking_rigs(), st.sampled_from(COUNTS), seeds, st.floats(0, 2), st.floats(0, 0.9))
def test_native_agrees_with_the_reference(level, rig, count, seed, noise_px, unseen):
    projections, pixels, _ = scene(rig, count, seed, noise_px, unseen)
    expected = load("reference").triangulate(projections, pixels)
    found = load(level).triangulate(projections, pixels)
    assert found.shape == (count, 3)
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-6)


@everything
@given(looking_rigs(), seeds)
def test_without_noise_the_points_are_recovered(name, rig, seed):
    projections, pixels, points = scene(rig, 9, seed)
    np.testing.assert_allclose(load(name).triangulate(projections, pixels), points, atol=1e-5)


@everything
@given(looking_rigs(minimum=3), seeds)
def test_any_two_views_are_enough_and_one_is_not(name, rig, seed):
    projections, pixels, points = scene(rig, 12, seed)
    rng = np.random.default_rng(seed)
    views = [rng.permutation(len(projections))[: 1 + i % 2] for i in range(12)]  # one, two, one, two, …
    for i, kept in enumerate(views):
        pixels[np.setdiff1d(np.arange(len(projections)), kept), i] = np.nan
    found = load(name).triangulate(projections, pixels)
    assert np.isnan(found[::2]).all()
    np.testing.assert_allclose(found[1::2], points[1::2], atol=1e-4)


@everything
@given(looking_rigs(minimum=2, maximum=2), seeds)
def test_parallel_rays_give_nan(name, rig, seed):
    """Two cameras of one orientation that see a point in the same direction."""
    first = rig.core_camera.matrix @ np.eye(3, 4)
    second = rig.core_camera.matrix @ np.column_stack([np.eye(3), [-100.0, 20.0, 0.0]])
    pixel = np.random.default_rng(seed).uniform(0, rig.core_camera.size_px)
    pixels = np.broadcast_to(pixel, (2, 3, 2))
    assert np.isnan(load(name).triangulate(np.stack([first, second]), pixels)).all()


@everything
@given(looking_rigs(), seeds, st.sampled_from([np.nan, np.inf, -np.inf]))
def test_an_unseen_camera_does_not_matter(name, rig, seed, nothing):
    projections, pixels, _ = scene(rig, 9, seed, noise_px=0.5)
    blind = np.concatenate([projections, np.random.default_rng(seed).normal(size=(1, 3, 4))])
    unseen = np.concatenate([pixels, np.full((1, 9, 2), nothing)])
    kernels = load(name)
    np.testing.assert_array_equal(
        kernels.triangulate(blind, unseen), kernels.triangulate(projections, pixels)
    )


@everything
def test_a_point_does_not_depend_on_its_neighbours(name):
    rng = np.random.default_rng(3)
    rig = looking_rig()
    projections, pixels, _ = scene(rig, 41, 3, noise_px=0.3, unseen=0.3)
    together = load(name).triangulate(projections, pixels)
    order = rng.permutation(41)
    np.testing.assert_array_equal(load(name).triangulate(projections, pixels[:, order]), together[order])
    alone = [load(name).triangulate(projections, pixels[:, i : i + 1])[0] for i in range(41)]
    np.testing.assert_array_equal(alone, together)


@every_level
@pytest.mark.parametrize("threads", [0, 2, 3, 8])
def test_the_number_of_threads_does_not_change_a_byte(level, threads):
    projections, pixels, _ = scene(looking_rig(), 30_011, 5, noise_px=0.3, unseen=0.2)
    one = load(level).triangulate(projections, pixels, threads=1)
    assert load(level).triangulate(projections, pixels, threads=threads).tobytes() == one.tobytes()


@pytest.mark.skipif(len(levels()) < 2, reason="only one instruction-set level on this processor")
def test_the_levels_agree_to_the_last_digits():
    projections, pixels, _ = scene(looking_rig(), 5001, 7, noise_px=0.3, unseen=0.2)
    lowest, *others = [load(level).triangulate(projections, pixels) for level in levels()]
    for other in others:
        assert other.tobytes() == lowest.tobytes()


@everything
def test_input_arrays_are_left_alone_whatever_their_layout(name):
    projections, pixels, points = scene(looking_rig(), 10, 11)
    kernels = load(name)
    strided = np.asfortranarray(pixels)
    before = strided.copy()
    np.testing.assert_allclose(
        kernels.triangulate(np.asfortranarray(projections), strided), points, atol=1e-5
    )
    np.testing.assert_array_equal(strided, before)
    single = kernels.triangulate(projections, pixels.astype(np.float32))
    assert single.dtype == np.float64
    np.testing.assert_allclose(single, points, atol=0.05)


@everything
@pytest.mark.parametrize(
    ("projections", "pixels", "message"),
    [
        ((3, 4), (2, 5, 2), "projections must have the shape (n, 3, 4), not (3, 4)"),
        ((2, 4, 3), (2, 5, 2), "projections must have the shape (n, 3, 4), not (2, 4, 3)"),
        ((2, 3, 4), (3, 5, 2), "pixels must have the shape (2, N, 2) for 2 cameras, not (3, 5, 2)"),
        ((2, 3, 4), (2, 5, 3), "pixels must have the shape (2, N, 2) for 2 cameras, not (2, 5, 3)"),
        ((2, 3, 4), (5, 2), "pixels must have the shape (2, N, 2) for 2 cameras, not (5, 2)"),
    ],
)
def test_wrong_shapes_are_named(name, projections, pixels, message):
    with pytest.raises(KernelError) as error:
        load(name).triangulate(np.zeros(projections), np.zeros(pixels))
    assert str(error.value) == message


def looking_rig() -> Rig:
    """Three fixed cameras about z = 1000 mm."""
    from beltscape.core.geometry.camera import Camera
    from beltscape.core.geometry.pose import Pose

    sides = {"left": -200.0, "core": 0.0, "right": 180.0}
    camera = {n: Camera(n, (640, 480), np.full(2, 800.0), np.array([320.0, 240]), np.zeros(5)) for n in sides}
    poses = {n: Pose.of([0, s / 1000, 0], [-s, 0, 0]) for n, s in sides.items()}
    return Rig("core", camera, poses)
