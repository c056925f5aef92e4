"""Periodic checks of a running belt: largest lump and lateral offset."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.measure.belt.empty_belt import learn_belt
from beltscape.measure.flow.periodic_checks import measure_belt_offset, measure_largest_lump
from beltscape.measure.lumps.settings import LumpSettings
from tests.measure.belt_scenes import Ball, Scene, depth_map, trough

TROUGH = trough(300, (190, 25))
EMPTY = Scene(TROUGH, floor_mm=-60.0)
CAMERA = EMPTY.camera
RADII = (22.0, 27.0, 30.0, 25.0)


def seen(scene: Scene, seed: int = 1):
    return depth_map(scene.depth_mm(), noise_mm=0.1, seed=seed)


def stones(*radii: float):
    places = ((-90.0, -80.0), (70.0, -70.0), (-60.0, 70.0), (85.0, 75.0))
    return tuple(Ball((*place, radius), radius) for place, radius in zip(places, radii, strict=False))


@pytest.fixture(scope="module")
def belt():
    return learn_belt([seen(EMPTY)], CAMERA)


@pytest.mark.parametrize("radius", [22.0, 40.0, 60.0])
def test_the_largest_lump_is_that(belt, radius):
    scene = Scene(TROUGH, stones(20.0, radius, 21.0, 18.0), floor_mm=-60.0)
    size, sigma = measure_largest_lump(seen(scene), CAMERA, belt)
    assert abs(size - 2 * radius) < 3 * sigma
    assert sigma < 0.2 * size


def test_an_empty_belt_has_none(belt):
    size, sigma = measure_largest_lump(seen(EMPTY, 3), CAMERA, belt)
    assert size == 0
    assert 0 < sigma < 40


def test_no_deviation_is_reported_where_nothing_is_measured(belt):
    blind = depth_map(np.full(CAMERA.size_px[::-1], np.nan))
    assert np.isnan(measure_largest_lump(blind, CAMERA, belt)).all()
    assert np.isnan(measure_belt_offset(blind, CAMERA, belt)).all()


def test_coarser_check_gives_nearly_the_same_deviation(belt):
    scene = Scene(TROUGH, stones(40.0, 55.0, 45.0, 50.0), floor_mm=-60.0)
    fine, _ = measure_largest_lump(seen(scene), CAMERA, belt)
    coarse, sigma = measure_largest_lump(seen(scene), CAMERA, belt, LumpSettings(raster_pixels=25_000))
    assert abs(coarse - fine) < 3 * sigma


def test_depth_of_another_camera_is_refused(belt):
    with pytest.raises(InputError, match="give the depth and the rig of one reconstruction"):
        measure_largest_lump(depth_map(np.full((50, 60), 700.0)), CAMERA, belt)


@pytest.mark.parametrize("shift_mm", [-15.0, 8.0])
def test_lateral_belt_run_off_under_stones_is_reported(belt, shift_mm):
    rise = np.tan(np.deg2rad(25))
    moved = TROUGH.copy()
    moved[0] += [shift_mm, -rise * shift_mm]
    moved[-1] += [shift_mm, rise * shift_mm]
    offset, sigma = measure_belt_offset(seen(Scene(moved, stones(*RADII), floor_mm=-60.0), 5), CAMERA, belt)
    assert abs(offset - shift_mm) < 4 * sigma
    assert sigma < 2


def test_a_belt_whose_ends_are_not_seen_has_no_offset():
    closed = Scene(TROUGH)
    alone = learn_belt([seen(closed)], CAMERA)
    assert np.isnan(measure_belt_offset(seen(Scene(TROUGH, stones(*RADII))), CAMERA, alone)).all()
