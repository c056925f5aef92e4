"""The plane sweep: accuracy of a plane step, edges in place, over the whole depth range."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.stereo.multiview.depth_range import shrink_frame, sweep_planes
from beltscape.stereo.multiview.surface import enlarge_blocks
from tests.stereo.scenes import (
    DEPTH_MM,
    make_ring,
    make_scene,
    mask_away_from_steps,
    mask_inner,
    patch,
    plane,
)

PLANE_STEP_PX = 0.5


def sweep(
    made, depth_range_mm: tuple[float, float], shrink: int = 1, plane_step_px: float = PLANE_STEP_PX
) -> np.ndarray:
    near, far = depth_range_mm
    small = shrink_frame(made.prepared, shrink)
    s_range = 1 / (far * made.unit), 1 / (near * made.unit)
    s, margin = sweep_planes(small, s_range, plane_step_px * shrink)
    assert margin.shape == s.shape == small.core.shape
    return enlarge_blocks(s, shrink, made.s.shape)


@pytest.mark.parametrize(
    ("size_px", "shrink"),
    [((120, 100), 1), ((121, 99), 1), ((240, 200), 2), ((243, 201), 2), ((361, 302), 3)],
)
def test_sweep_of_a_plane_is_within_a_plane_step(size_px, shrink):
    made = make_scene(plane(DEPTH_MM, 0.1, 0.05), rig=make_ring(size_px=size_px))
    s = sweep(made, (560, 880), shrink)
    assert s.shape == (size_px[1], size_px[0])
    assert s.dtype == np.float32
    error = np.abs(s - made.s)[mask_inner(s.shape, 4 * shrink)]
    blocks = 0.15 * shrink  # a block of the slope has one value
    assert (error < PLANE_STEP_PX * shrink + blocks).mean() > 0.97
    assert np.median(error) < 0.5 * PLANE_STEP_PX * shrink


@pytest.mark.parametrize("plane_step_px", [0.25, 0.5, 1.0])
def test_planes_have_the_given_distance(plane_step_px):
    made = make_scene(plane(DEPTH_MM, 0.1, 0.05))
    error = np.abs(sweep(made, (560, 880), plane_step_px=plane_step_px) - made.s)[mask_inner(made.s.shape, 4)]
    assert (error < plane_step_px + 0.15).mean() > 0.95
    assert np.median(error) < 0.5 * plane_step_px


def test_sweep_of_a_step_keeps_its_edge():
    made = make_scene(plane(760), patch(660, (-150, 60), (-120, 120)))
    s = sweep(made, (600, 820))
    clear = mask_away_from_steps(made.s, 4) & mask_inner(s.shape, 4)
    assert (np.abs(s - made.s)[clear] < PLANE_STEP_PX).mean() > 0.97
    middle = (np.quantile(made.s, 0.02) + np.quantile(made.s, 0.98)) / 2
    assert ((s > middle) == (made.s > middle)).mean() > 0.96


@pytest.mark.parametrize("depth_mm", [650.0, 700.0, 750.0])
def test_planes_cover_the_range_up_to_its_ends(depth_mm):
    """The surface lies at the range's near end, in its middle and at its far end."""
    made = make_scene(plane(depth_mm))
    for near_far in ((depth_mm, 1100), (500, 1000), (480, depth_mm)):
        s = sweep(made, near_far)
        assert np.median(np.abs(s - made.s)) < PLANE_STEP_PX
        far, near = 1 / (near_far[1] * made.unit), 1 / (near_far[0] * made.unit)
        assert far - PLANE_STEP_PX <= s.min() <= s.max() <= near + PLANE_STEP_PX


def test_sweep_of_a_tiny_range_has_planes():
    made = make_scene(plane(700.0))
    assert np.median(np.abs(sweep(made, (699.9, 700.1)) - made.s)) < PLANE_STEP_PX
