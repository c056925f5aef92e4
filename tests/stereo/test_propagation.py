"""Propagation: pixels on the wrong side of a step take the other surface, smooth surfaces do not change."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from beltscape.kernels import load
from beltscape.stereo.multiview.optimisation import PropagationResult, list_propagation_offsets, propagate
from beltscape.stereo.multiview.surface import fit_slopes
from tests.stereo.scenes import DEPTH_MM, make_ring, make_scene, mask_inner, patch, plane, sphere

DISTANCES = (2, 5)


def run_propagation(made, s: np.ndarray, rounds: int = 1) -> PropagationResult:
    result = propagate(fit_slopes(s.astype(np.float32), load(), 1), made.prepared, DISTANCES)
    for _ in range(rounds - 1):
        result = propagate(result.surface, made.prepared, DISTANCES)
    return result


@pytest.mark.parametrize("angles", [(0, 90, 180, 270), (0, 180), (45, 135, 225)])
def test_propagation_restores_the_background_beside_a_fattened_foreground(angles):
    made = make_scene(plane(760), patch(680, (-150, 60), (-120, 120)), rig=make_ring(angles), noise=1.0)
    near, far = made.s.max(), made.s.min()
    fattened = cv2.dilate(made.s, np.ones((9, 9), np.uint8))  # 4 px to each side
    wrong = (np.abs(fattened - made.s) > 0.5 * (near - far)) & mask_inner(fattened.shape, 6)
    assert wrong.sum() > 400
    error = np.abs(run_propagation(made, fattened, rounds=2).surface.s - made.s)
    assert (error[wrong] < 0.3).mean() > 0.8
    right = ~wrong & mask_inner(fattened.shape, 6)
    assert (error[right] < 0.3).mean() > 0.99


def test_propagation_restores_a_foreground_that_is_too_thin():
    made = make_scene(plane(760), patch(680, (-150, 60), (-120, 120)), noise=1.0)
    thin = cv2.erode(made.s, np.ones((9, 9), np.uint8))
    wrong = (np.abs(thin - made.s) > 1) & mask_inner(thin.shape, 6)
    error = np.abs(run_propagation(made, thin, rounds=2).surface.s - made.s)
    assert (error[wrong] < 0.3).mean() > 0.8


@pytest.mark.parametrize(
    "solids", [(plane(DEPTH_MM, 0.3, -0.2),), (sphere(640, 900), plane(1100))], ids=["slanted", "sphere"]
)
def test_smooth_surface_is_unchanged(solids):
    made = make_scene(*solids, noise=1.0)
    result = run_propagation(made, made.s)
    moved = np.abs(result.surface.s - made.s)[mask_inner(made.s.shape, 8)]
    assert np.quantile(moved, 0.99) < 0.1  # a neighbour's plane deviates from a curved surface
    assert moved.max() < 0.4  # less than the least distance of candidates


def test_propagation_lowers_the_cost():
    made = make_scene(plane(760), patch(680, (-150, 60), (-120, 120)), noise=1.0)
    fattened = cv2.dilate(made.s, np.ones((9, 9), np.uint8))
    inside = mask_inner(fattened.shape, 8)
    first, second = run_propagation(made, fattened), run_propagation(made, fattened, rounds=2)
    assert second.cost[inside].mean() < first.cost[inside].mean() < 0.3
    for one in (first, second):
        assert ((one.cost >= 0) & (one.cost <= 1)).all()
        assert (one.margin >= 0).all()


@pytest.mark.parametrize("column", [111, 112, 125, 126, 127, 128])
def test_only_active_pixels_change_independent_of_workspace_contents(column):
    """The kernels begin a new tile at about column 126, and a new block at 112 and 128."""
    made = make_scene(
        plane(760), patch(680, (-150, 60), (-120, 120)), rig=make_ring(size_px=(160, 100)), noise=1.0
    )
    surface, prepared, kernels = fit_slopes(made.s, load(), 1), made.prepared, load()
    sizes = [image.shape[::-1] for image in prepared.images]
    buffers = kernels.inverse_depth_buffers(made.s, prepared.views, sizes, threads=1)
    active = np.zeros(made.s.shape, np.uint8)
    active[40:60, column] = 1

    def run_kernel(s, where):
        return kernels.propagate(
            s, surface.slope_u, surface.slope_v, prepared.core, prepared.images, prepared.views, buffers,
            offsets=list_propagation_offsets(DISTANCES), floor=prepared.noise.floor, active=where, threads=1,
        )  # fmt: skip

    first = run_kernel(made.s, active)
    np.testing.assert_array_equal(first.s[active == 0], made.s[active == 0])
    for shift in (3, -3):
        run_kernel(made.s + np.float32(shift), None)  # fills the workspace with other candidates
        for again, before in zip(run_kernel(made.s, active), first, strict=True):
            np.testing.assert_array_equal(again, before)


def test_offsets_have_eight_directions():
    found = list_propagation_offsets((1, 3, 8))
    assert found.dtype == np.int32
    assert len(np.unique(found, axis=0)) == 24
    assert not found.sum(axis=0).any()
    lengths = np.linalg.norm(found.reshape(3, 8, 2), axis=-1)
    np.testing.assert_allclose(lengths, np.repeat([[1], [3], [8]], 8, axis=1), atol=0.5)


@pytest.mark.parametrize("distances", [(3,), (3, 10), (2, 5, 12)])
def test_two_turns_have_all_directions_once(distances):
    first, second = (list_propagation_offsets(distances, turn) for turn in (0, 1))
    assert len(first) == len(second) == 4 * len(distances)
    np.testing.assert_array_equal(
        np.unique(np.concatenate([first, second]), axis=0),
        np.unique(list_propagation_offsets(distances), axis=0),
    )
    np.testing.assert_array_equal(list_propagation_offsets(distances, 2), first)
    assert not first.sum(axis=0).any()
