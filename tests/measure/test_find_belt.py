"""The belt frame found in one depth map of an empty belt."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError, MeasureError
from beltscape.measure.belt.empty_belt import Belt, find_belt
from tests.measure.belt_scenes import Ball, Scene, depth_map, round_trough, trough
from tests.thorough import list_cases

BELTS = {
    "three rolls": trough(300, (250, 25)),
    "three rolls, shallow": trough(260, (270, 15)),
    "three rolls, deep": trough(200, (250, 45)),
    "five rolls": trough(160, (160, 20), (160, 40)),
    "two rolls": trough(0, (380, 20)),
}
VIEWS: dict[str, dict[str, Any]] = {
    "straight": {},
    "tilted": {"tilt_deg": (4.0, -5.0)},
    "turned": {"belt_yaw_deg": 30.0},
    "crosswise": {"belt_yaw_deg": 88.0, "tilt_deg": (-3.0, 3.0)},
    "aside": {"camera_mm": (60.0, 0.0, 740.0), "tilt_deg": (1.0, 2.0)},
}


def turned(belt: Belt, scene: Scene) -> np.ndarray:
    """Small rotation (3,) rad from the true belt axes to the found ones; the sign of x is the core's +u."""
    world_from_core = scene.core_from_world.inverse().rotation
    rotation = belt.belt_from_core.rotation @ world_from_core.T
    if rotation[0, 0] < 0:
        rotation = np.diag([-1.0, -1.0, 1.0]) @ rotation
    return np.array([rotation[2, 1], rotation[0, 2], rotation[1, 0]])


@pytest.mark.parametrize(
    ("belt", "view"),
    [
        pytest.param(belt, view, marks=() if i == j and i in (0, 3, 4) else pytest.mark.thorough)
        for i, belt in enumerate(BELTS)
        for j, view in enumerate(VIEWS)
    ],
)
def test_exact_depth_gives_the_frame(belt: str, view: str) -> None:
    scene = Scene(BELTS[belt], **VIEWS[view])
    found = find_belt(depth_map(scene.depth_mm()), scene.camera)
    assert found.yaw_from == "shape"
    assert (found.flat_mm is None) == (belt == "two rolls")
    np.testing.assert_allclose(turned(found, scene), 0, atol=1e-4 if belt != "two rolls" else 1e-3)
    assert found.belt_from_core.rotation[0, 0] > 0


def test_origin_is_on_the_optical_axis_and_on_the_belt() -> None:
    # the axis meets the wing, not the flat
    scene = Scene(BELTS["three rolls"], camera_mm=(200.0, 0.0, 740.0))
    found = find_belt(depth_map(scene.depth_mm()), scene.camera)
    origin_in_core = found.belt_from_core.center_mm * 0 + found.belt_from_core.inverse().translation_mm
    expected = 740.0 - (200 - 150) * np.tan(np.deg2rad(25))
    np.testing.assert_allclose(origin_in_core, [0, 0, expected], atol=0.3)
    assert found.height_mm(np.array([0.0]))[0] == pytest.approx(0, abs=0.05)
    assert found.height_mm(np.array([-200.0]))[0] == pytest.approx(-23.3, abs=0.3)


@pytest.mark.parametrize("seed", list_cases(range(3), [0]))
def test_noise_holes_and_gross_errors_move_it_within_its_sigma(seed: int) -> None:
    scene = Scene(BELTS["three rolls"], tilt_deg=(3.0, 2.0), belt_yaw_deg=10.0)
    depth = depth_map(scene.depth_mm(), noise_mm=0.3, seed=seed, holes=0.15, gross=0.02)
    found = find_belt(depth, scene.camera)
    error = turned(found, scene)
    assert found.yaw_sigma_rad is not None
    assert np.abs(error[:2]).max() < 4 * found.tilt_sigma_rad < 1e-3
    assert abs(error[2]) < 4 * found.yaw_sigma_rad < 1e-3
    assert found.flat_rms_mm == pytest.approx(0.3, rel=0.15)
    assert found.correlation_px == pytest.approx(5, rel=0.25)


def test_flat_belt_takes_its_direction_from_its_edges() -> None:
    scene = Scene(trough(500), floor_mm=-150.0, belt_yaw_deg=30.0, tilt_deg=(2.0, 1.0))
    found = find_belt(depth_map(scene.depth_mm(), noise_mm=0.2), scene.camera)
    assert found.yaw_from == "edges"
    assert found.yaw_sigma_rad is not None
    error = turned(found, scene)
    assert abs(error[2]) < 3 * found.yaw_sigma_rad < 0.01
    assert np.abs(error[:2]).max() < 2e-4
    assert np.diff(found.across_mm)[0] == pytest.approx(500, abs=12)


@pytest.mark.parametrize("yaw_deg", [-38.0, 17.0])
def test_edges_in_two_corners_of_the_image_show_the_direction_together(yaw_deg: float) -> None:
    # each is shorter than three tenths of the view, which one edge alone must have
    scene = Scene(trough(800), floor_mm=-400.0, belt_yaw_deg=yaw_deg)
    found = find_belt(depth_map(scene.depth_mm(), noise_mm=0.2), scene.camera)
    assert found.yaw_from == "edges"
    assert found.yaw_sigma_rad is not None
    assert abs(turned(found, scene)[2]) < 3 * found.yaw_sigma_rad < 0.02


def test_flat_belt_without_edges_reports_that_the_camera_gave_the_direction() -> None:
    scene = Scene(trough(2000), tilt_deg=(0.0, 3.0))
    found = find_belt(depth_map(scene.depth_mm(), noise_mm=0.2), scene.camera)
    assert (found.yaw_from, found.yaw_sigma_rad) == ("camera", None)
    assert np.abs(turned(found, scene)[:2]).max() < 2e-4
    assert found.belt_from_core.rotation[0, 1] == pytest.approx(0, abs=1e-3)


def test_round_belt_stands_on_the_middle_of_what_is_seen() -> None:
    scene = Scene(round_trough(500, 30))
    found = find_belt(depth_map(scene.depth_mm(), noise_mm=0.1), scene.camera)
    assert found.flat_mm is None
    assert np.abs(turned(found, scene)).max() < 5e-3


def test_floor_beside_a_trough_is_no_belt() -> None:
    scene = Scene(trough(200, (150, 30)), floor_mm=-150.0, belt_yaw_deg=-20.0)
    found = find_belt(depth_map(scene.depth_mm(), noise_mm=0.2), scene.camera)
    assert np.abs(turned(found, scene)).max() < 1e-3
    np.testing.assert_allclose(found.across_mm, [-230, 230], atol=6)


def test_a_heap_is_no_empty_belt() -> None:
    rng = np.random.default_rng(1)
    places = rng.uniform([-350, -330, 0], [350, 330, 30], (250, 3))
    heap = tuple(
        Ball((x, y, z), float(r)) for (x, y, z), r in zip(places, rng.uniform(20, 45, 250), strict=True)
    )
    scene = Scene(BELTS["three rolls"], heap)
    with pytest.raises(MeasureError, match=r"give the frame of an empty belt|no even surface"):
        find_belt(depth_map(scene.depth_mm()), scene.camera)


def test_what_is_missing_is_named() -> None:
    scene = Scene(BELTS["three rolls"])
    nothing = depth_map(np.full_like(scene.depth_mm(), np.nan))
    with pytest.raises(MeasureError, match=r"only 0\.0% of the pixels"):
        find_belt(nothing, scene.camera)
    depth = depth_map(scene.depth_mm())
    half = DepthMap(
        depth.depth_mm[::2, ::2], depth.sigma_mm[::2, ::2], depth.views[::2, ::2], depth.confidence[::2, ::2]
    )
    with pytest.raises(InputError, match="153×129, the core camera 306×257"):
        find_belt(half, scene.camera)
