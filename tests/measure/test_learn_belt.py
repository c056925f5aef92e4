"""The empty belt learned from several depth maps, with its ends and edges."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError
from beltscape.measure.belt.edges import find_belt_edges
from beltscape.measure.belt.empty_belt import average_depth_maps, learn_belt
from tests.measure.belt_scenes import Block, Scene, depth_map, trough
from tests.thorough import THOROUGH, list_cases

TROUGH = trough(300, (190, 25))
OPEN = Scene(TROUGH, floor_mm=-60.0)


def frames(scene: Scene, number: int, noise_mm: float = 0.3, first: int = 0) -> list[DepthMap]:
    exact = scene.depth_mm()
    return [depth_map(exact, noise_mm=noise_mm, seed=first + k) for k in range(number)]


def test_nine_frames_have_a_third_of_the_error_and_sigma_of_one() -> None:
    scene = Scene(trough(300, (250, 25)))
    rise = np.tan(np.deg2rad(25))
    one = [learn_belt(frames(scene, 1, first=k), scene.camera) for k in range(4 if THOROUGH else 2)]
    nine = [
        learn_belt(frames(scene, 9, first=20 * k + 10), scene.camera) for k in range(3 if THOROUGH else 1)
    ]
    x = np.linspace(-300, 300, 400)
    x = x[np.abs(np.abs(x) - 150) > 15]  # not at the folds, which no raster resolves

    true = np.clip(np.abs(x) - 150, 0, None) * rise

    def errors(belts):
        return np.sqrt(np.mean([(b.height_mm(x) - true) ** 2 for b in belts]))

    assert errors(nine) < 0.5 * errors(one)
    assert nine[0].frames == 9
    assert nine[0].noise_mm == pytest.approx(one[0].noise_mm / 3, rel=0.15)
    assert np.median(nine[0].z_sigma_mm) == pytest.approx(np.median(one[0].z_sigma_mm) / 3, rel=0.3)
    assert nine[0].tilt_sigma_rad < 0.5 * one[0].tilt_sigma_rad
    # and what it says of its cross-section is true
    ratio = (one[0].height_mm(x) - true) / np.interp(x, one[0].x_mm, one[0].z_sigma_mm)
    assert 0.6 < 1.4826 * np.median(np.abs(ratio)) < 1.6


def test_objects_on_few_frames_are_ignored() -> None:
    scene = Scene(TROUGH)
    clean = frames(scene, 6, 0.1)
    loaded = depth_map(Scene(TROUGH, (Block((0.0, 0.0), (80.0, 80.0, 40.0)),)).depth_mm(), noise_mm=0.1)
    off = average_depth_maps([*clean, loaded]).depth_mm - scene.depth_mm()
    assert np.nanmax(np.abs(off)) < 1.0


def test_averaging_keeps_holes_that_most_frames_have() -> None:
    depth = depth_map(Scene(TROUGH).depth_mm())
    holed = depth.depth_mm.copy()
    holed[40:60, 40:60] = np.nan
    bare = DepthMap(holed, depth.sigma_mm, depth.views, depth.confidence)
    assert np.isnan(average_depth_maps([bare] * 4 + [depth]).depth_mm[50, 50])
    assert np.isfinite(average_depth_maps([bare] + [depth] * 4).depth_mm[50, 50])
    assert average_depth_maps([depth] * 4).sigma_mm[50, 50] == pytest.approx(depth.sigma_mm[50, 50] / 2)


def test_no_frame_is_refused() -> None:
    with pytest.raises(InputError, match="no frame given"):
        learn_belt([], OPEN.camera)


def test_ends_are_found_against_the_floor() -> None:
    belt = learn_belt(frames(OPEN, 1, 0.1), OPEN.camera)
    assert belt.edges is not None
    end = 150 + 190 * np.cos(np.deg2rad(25))
    middle = belt.belt_from_core.translation_mm[0]  # of the camera, over the trough's middle
    for found, sigma, true in (
        (belt.edges.left_mm, belt.edges.left_sigma_mm, -end + middle),
        (belt.edges.right_mm, belt.edges.right_sigma_mm, end + middle),
    ):
        assert abs(found - true) < 4 * sigma
        assert sigma < 2
    assert abs(belt.edges.offset_mm) < 4 * belt.edges.sigma_mm


def test_a_belt_with_nothing_behind_it_has_no_ends_to_be_seen() -> None:
    belt = learn_belt(frames(Scene(TROUGH), 1, 0.1), OPEN.camera)
    assert belt.edges is not None
    assert np.isnan([belt.edges.left_mm, belt.edges.right_mm, belt.edges.offset_mm]).all()


@pytest.mark.parametrize("shift_mm", list_cases([-12.0, 9.0], [-12.0]))
def test_lateral_belt_run_off_under_load_is_reported(shift_mm: float) -> None:
    belt = learn_belt(frames(OPEN, 2, 0.1), OPEN.camera)
    # one end climbs, the trough stays
    rise = np.tan(np.deg2rad(25))
    moved = TROUGH.copy()
    moved[0] += [shift_mm, -rise * shift_mm]
    moved[-1] += [shift_mm, rise * shift_mm]
    load = Block((0.0, 0.0), (150.0, 120.0, 60.0))
    loaded = depth_map(Scene(moved, (load,), floor_mm=-60.0).depth_mm(), noise_mm=0.1, seed=9)
    edges = find_belt_edges(loaded, OPEN.camera, belt)
    assert edges.against == "learned"
    assert abs(edges.offset_mm - shift_mm) < 4 * edges.sigma_mm
    assert edges.sigma_mm < 2


def test_sag_is_learned_and_an_even_belt_has_none() -> None:
    scene = Scene(trough(300, (250, 25)))
    even = learn_belt(frames(scene, 1, 0.05), scene.camera)
    assert even.deviation is None
    exact = scene.depth_mm()
    rays = scene.camera.rays()
    y = rays[..., 1] * exact
    hanging = depth_map(exact + 2.0 * (y / 250) ** 2, noise_mm=0.05)
    belt = learn_belt([hanging], scene.camera)
    assert belt.deviation is not None
    x, along = np.linspace(-120, 120, 20), np.linspace(-200, 200, 30)
    surface = belt.surface_mm(x, along)
    expected = -2.0 * (along / 250) ** 2
    assert np.ptp((surface - surface.mean()).mean(axis=1) - expected) < 0.35
    assert belt.noise_mm < 0.1
