"""Volumes of known solids on a belt, with their σ."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy import ndimage

from beltscape.core.depth import DepthMap
from beltscape.core.empty_belt import Belt
from beltscape.core.errors import InputError, MeasureError
from beltscape.measure.belt.empty_belt import learn_belt
from beltscape.measure.volume.settings import VolumeSettings
from beltscape.measure.volume.volume import Volume, measure_volume
from tests.measure.belt_scenes import (
    Ball,
    Block,
    Cone,
    HalfCylinder,
    Scene,
    camera_of,
    depth_map,
    round_trough,
    trough,
)
from tests.thorough import THOROUGH

TROUGH = trough(300, (250, 25))
MIDDLE = {"across_mm": (-140.0, 140.0), "along_mm": (-150.0, 150.0)}


BELTS: dict[tuple[Any, ...], Belt] = {}
"""Belts that tests have learned, by their cross-section, noise and view."""


def measured(
    solids: tuple,
    box: dict[str, Any],
    *,
    section: np.ndarray = TROUGH,
    seed: int = 0,
    noise: Any = None,
    **view: Any,
) -> Volume:
    empty, loaded = Scene(section, **view), Scene(section, solids, **view)
    noise = noise or {}
    noise_mm = noise.get("noise_mm", 0.0)
    key = (section.tobytes(), seed, noise_mm, *view.items())
    if key not in BELTS:
        bare = depth_map(empty.depth_mm(), seed=2 * seed + 1, noise_mm=noise_mm)
        BELTS[key] = learn_belt([bare], empty.camera)
    return measure_volume(
        depth_map(loaded.depth_mm(), seed=2 * seed, **noise),
        BELTS[key],
        empty.camera,
        VolumeSettings(),
        **box,
    )


SOLIDS = {
    "cone": (Cone((10.0, -20.0), 90.0, 60.0), 0.003),
    "half cylinder": (HalfCylinder((20.0, 10.0), 40.0, 150.0, 30.0), 0.01),
    "block": (Block((40.0, 30.0), (100.0, 80.0, 60.0), 20.0), 0.015),
}
VIEWS: dict[str, dict[str, Any]] = {
    "trough": {"section": TROUGH, "camera": camera_of(612)},
    "flat, tilted": {"section": trough(900), "tilt_deg": (3.0, -2.0), "camera": camera_of(460)},
    "five rolls, turned": {
        "section": trough(260, (150, 20), (120, 40)),
        "belt_yaw_deg": 35.0,
        "camera": camera_of(460),
    },
}


@pytest.mark.parametrize(
    ("solid", "view"),
    [
        pytest.param(solid, view, marks=() if i == j else pytest.mark.thorough)
        for i, solid in enumerate(SOLIDS)
        for j, view in enumerate(VIEWS)
    ],
)
def test_known_solids(solid: str, view: str) -> None:
    body, tolerance = SOLIDS[solid]
    box = {"across_mm": (-200.0, 200.0), "along_mm": (-200.0, 200.0)}
    found = measured((body,), box, **VIEWS[view])
    error = found.volume_mm3 - body.volume_mm3
    assert abs(error) < tolerance * body.volume_mm3
    assert abs(error) < 2 * found.sigma_mm3 + 2.5e-3 * body.volume_mm3


def test_box_may_cut_a_solid_anywhere() -> None:
    body = Block((0.0, 0.0), (100.0, 100.0, 50.0))
    for low in (-33.3, 0.0, 12.7):
        found = measured(
            (body,), {"across_mm": (low, 140.0), "along_mm": (-20.0, 31.0)}, camera=camera_of(612)
        )
        assert found.volume_mm3 == pytest.approx((50 - low) * 51 * 50, rel=0.02)


def test_sigma_is_honest() -> None:
    body = Cone((10.0, -20.0), 90.0, 60.0)
    noise = {"noise_mm": 0.3}
    found = [measured((body,), MIDDLE, seed=seed, noise=noise) for seed in range(12 if THOROUGH else 5)]
    errors = np.array([(v.volume_mm3 - body.volume_mm3) / v.sigma_mm3 for v in found])
    assert 0.7 < np.sqrt(np.mean(errors**2)) < 1.4


def test_a_board_of_another_size_changes_the_volume_as_sigma_says() -> None:
    """All depths are off by a share ε, as by a rig from such a board: the volume by 3 ε, which is in its causes."""
    body, scale = Cone((10.0, -20.0), 90.0, 60.0), 0.004
    empty, loaded = Scene(TROUGH), Scene(TROUGH, (body,))
    volumes = []
    for factor in (1.0, 1 + scale):
        belt = learn_belt([depth_map(factor * empty.depth_mm(), seed=1)], empty.camera)
        volumes.append(
            measure_volume(
                depth_map(factor * loaded.depth_mm(), seed=2), belt, empty.camera, VolumeSettings(), **MIDDLE,
                scale_sigma=scale,
            )
        )  # fmt: skip
    change_mm3 = volumes[1].volume_mm3 - volumes[0].volume_mm3
    assert volumes[0].causes.scale_mm3 == pytest.approx(change_mm3, rel=0.05)
    assert volumes[0].sigma_mm3 > volumes[0].causes.scale_mm3


def test_holes_count_in_coverage_and_sigma_and_leave_the_volume() -> None:
    body = Cone((10.0, -20.0), 90.0, 60.0)
    whole = measured((body,), MIDDLE, noise={"noise_mm": 0.3})
    holed = measured((body,), MIDDLE, noise={"noise_mm": 0.3, "holes": 0.15})
    assert whole.coverage > 0.99
    assert 0.6 < holed.coverage < 0.9
    assert holed.sigma_mm3 > 1.5 * whole.sigma_mm3
    assert abs(holed.volume_mm3 - body.volume_mm3) < 2.5 * holed.sigma_mm3
    assert holed.interpolated.mean() > whole.interpolated.mean()


def test_gross_errors_do_not_move_the_volume() -> None:
    body = Cone((10.0, -20.0), 90.0, 60.0)
    found = measured((body,), MIDDLE, noise={"noise_mm": 0.3, "gross": 0.02})
    assert found.volume_mm3 == pytest.approx(body.volume_mm3, rel=0.02)


def test_an_empty_belt_holds_nothing_and_is_not_clipped() -> None:
    found = [measured((), MIDDLE, seed=seed, noise={"noise_mm": 0.3}) for seed in range(6 if THOROUGH else 5)]
    volumes = np.array([v.volume_mm3 for v in found])
    assert np.abs(volumes).max() < 3 * found[0].sigma_mm3
    assert (volumes < 0).any()
    assert (volumes > 0).any()


def test_without_a_box_the_measured_range_is_used_and_reported() -> None:
    found = measured((Ball((0.0, 0.0, 20.0), 40.0),), {"across_mm": None, "along_mm": None})
    assert found.across_mm[0] < -320
    assert found.across_mm[1] > 320
    assert found.along_mm[0] < -230
    assert found.coverage > 0.9
    assert found.volume_mm3 == pytest.approx(np.pi * (40**2 * 20 + 40**3 * 2 / 3), rel=0.05)
    assert found.profiles[0].y_mm - 25 == pytest.approx(found.along_mm[0], abs=5)
    total = sum(p.area_mm2 for p in found.profiles) * np.ptp(found.along_mm) / len(found.profiles)
    assert total == pytest.approx(found.volume_mm3, rel=1e-6)
    step = found.y_mm[1] - found.y_mm[0]
    assert np.sum(found.area_mm2) * step == pytest.approx(found.volume_mm3, rel=0.02)


def test_load_is_the_height_over_the_belt() -> None:
    found = measured((Block((-30.0, 20.0), (80.0, 60.0, 50.0)),), MIDDLE, noise={"noise_mm": 0.1})
    x, y = np.meshgrid(found.load.x_mm, found.load.y_mm)
    top = (np.abs(x + 30) < 30) & (np.abs(y - 20) < 20)
    assert np.median(found.load.height_mm[top]) == pytest.approx(50, abs=0.1)
    assert np.abs(np.median(found.load.height_mm[np.abs(x) > 200])) < 0.1


def test_box_beyond_the_view_is_reported() -> None:
    body = Cone((10.0, -20.0), 90.0, 60.0)
    inside = measured((body,), MIDDLE)
    outside = measured((body,), {"across_mm": (-140.0, 140.0), "along_mm": (-150.0, 650.0)})
    assert outside.coverage < 0.7
    assert outside.sigma_mm3 > 5 * inside.sigma_mm3
    with pytest.raises(
        MeasureError, match=r"--along 700 800: nothing was measured there; the belt was seen from"
    ):
        measured((body,), {"across_mm": None, "along_mm": (700.0, 800.0)})


def test_sigma_holds_what_a_load_may_carry_beyond_the_view() -> None:
    box = {"across_mm": (-140.0, 140.0), "along_mm": (-150.0, 450.0)}
    found = measured((Block((0.0, 0.0), (100.0, 2000.0, 60.0)),), box, noise={"noise_mm": 0.3})
    beyond = 100 * 60 * (450 - 260)
    assert found.causes.unseen_mm3 > 0.5 * beyond  # it may go on, as it does, or end
    assert abs(found.volume_mm3 - 100 * 60 * 600) < 2 * found.sigma_mm3
    assert measured((), box).causes.unseen_mm3 < 0.01 * beyond


def test_sigma_holds_what_a_heap_that_rises_out_of_the_view_carries_beside_it() -> None:
    heap, box = Block((0.0, 0.0), (640.0, 2000.0, 280.0)), {"across_mm": None, "along_mm": (-100.0, 100.0)}
    found = measured((heap,), box, section=trough(700), noise={"noise_mm": 0.3})
    missing = 640 * 200 * 280 - found.volume_mm3
    assert found.across_mm[1] < 250
    assert 0.5 * found.sigma_mm3 < missing < 2 * found.sigma_mm3
    assert found.causes.unseen_mm3 > 0.9 * found.sigma_mm3


def test_depths_that_may_be_false_beside_a_step_enter_sigma() -> None:
    scene = Scene(TROUGH, (Block((0.0, 0.0), (100.0, 100.0, 60.0)),))
    whole = depth_map(scene.depth_mm(), noise_mm=0.1)
    belt = learn_belt([depth_map(Scene(TROUGH).depth_mm(), seed=1, noise_mm=0.1)], scene.camera)
    points = belt.belt_from_core.apply(whole.points_mm(scene.camera))
    z = np.where(np.abs(points[..., 0]) < 130, points[..., 2], 0.0)
    rim = (z > 30) & ndimage.binary_dilation(z < 30, iterations=3)
    flat = (z < 30) & ~ndimage.binary_dilation(z > 30, iterations=40)
    sigmas = {
        name: measure_volume(
            replace(whole, confidence=np.where(doubtful, 0.6, 1.0).astype(np.float32)),
            belt, scene.camera, VolumeSettings(), **MIDDLE,
        ).causes.false_depths_mm3
        for name, doubtful in (("rim", rim), ("flat", flat), ("none", np.zeros_like(rim)))
    }  # fmt: skip
    pixel_mm2 = float(np.prod(belt.belt_from_core.inverse().translation_mm[2] / scene.camera.focal_px))
    high = 0.5 * 0.4 * 60 * rim.sum() * pixel_mm2  # half of what they would be too high by
    assert sigmas["rim"] == pytest.approx(high, rel=0.3)
    assert sigmas["flat"] < 0.02 * sigmas["rim"]
    assert sigmas["none"] == 0


def test_round_belts_are_measured_too() -> None:
    ball = Ball((0.0, 0.0, 60.0), 50.0)
    found = measured((ball,), MIDDLE, section=round_trough(500, 30), camera=camera_of(408))
    x, y = np.meshgrid(*(np.arange(-50, 50.0),) * 2)
    top = 60 + np.sqrt(np.clip(50**2 - x**2 - y**2, 0, None))
    belt = 500 - np.sqrt(500**2 - x**2)
    exact = np.sum(np.where(np.hypot(x, y) < 50, top - belt, 0))
    assert found.volume_mm3 == pytest.approx(exact, rel=0.03)


def test_a_map_of_another_size_is_refused() -> None:
    scene = Scene(TROUGH)
    depth = depth_map(scene.depth_mm())
    half = DepthMap(
        depth.depth_mm[::2, ::2], depth.sigma_mm[::2, ::2], depth.views[::2, ::2], depth.confidence[::2, ::2]
    )
    belt = learn_belt([depth], scene.camera)
    with pytest.raises(InputError, match="153×129, the core camera 306×257"):
        measure_volume(half, belt, scene.camera, VolumeSettings(), across_mm=None, along_mm=None)


def test_settings_are_bounded() -> None:
    assert VolumeSettings().profile_every_mm == 50
    with pytest.raises(ValidationError, match="cell_mm"):
        VolumeSettings(cell_mm=0)
    with pytest.raises(ValidationError, match="cell"):
        VolumeSettings.model_validate({"cell": 2})
