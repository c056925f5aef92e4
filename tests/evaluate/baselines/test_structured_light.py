"""Decoded depth: exact on synthetic images of a slanted plane, right on a rendered scene, wrong when it moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.evaluate.structured_light import DecodeSettings, decode
from beltscape.simulate.core_truth import trace_core_truth
from beltscape.simulate.projected_sequence import FringeSettings, make_fringe_patterns, render_sequence
from beltscape.simulate.rig_and_projector import make_projector
from beltscape.simulate.scene_assembly import SimulatedScene
from tests.simulate.tiny import CUBES, tiny

CORE = Camera("cam0", (160, 120), np.array([150.0, 151.0]), np.array([79.0, 60.5]), np.zeros(5))
LIGHT = Camera("projector", (640, 400), np.full(2, 560.0), np.array([319.5, 199.5]), np.zeros(5))
POSE = Pose.of([0.02, 0.3, 0.01], [-220.0, 3.0, 40.0])
FRINGES = FringeSettings(fringes=(1.0, 6.0, 36.0), steps=4)


def plane() -> np.ndarray:
    """(H, W) depth of a plane that leans."""
    x, y = np.moveaxis(CORE.rays(), -1, 0)
    return 700 / (1 + 0.2 * x - 0.1 * y)


def columns_seen(depth: np.ndarray) -> np.ndarray:
    points = np.concatenate([CORE.rays() * depth[..., None], depth[..., None]], axis=-1)
    return LIGHT.project(POSE.apply(points.reshape(-1, 3)))[:, 0].reshape(depth.shape)


def images_of(columns: np.ndarray, brightest: float = 200.0) -> np.ndarray:
    light = [
        0.5 + 0.5 * np.cos(2 * np.pi * (columns / period - k / FRINGES.steps))
        for period in FRINGES.periods_px(LIGHT.size_px[0])
        for k in range(FRINGES.steps)
    ]
    return np.rint(20 + brightest * np.array(light)).astype(np.uint8)


def test_a_leaning_plane_is_found():
    depth = plane()
    found = decode(images_of(columns_seen(depth)), CORE, LIGHT, POSE, FRINGES)
    assert found.coverage > 0.95
    error = (found.depth_mm - depth)[found.measured]
    assert np.abs(error).max() < 0.5  # of counts that are whole numbers
    assert np.abs(np.median(error)) < 0.01


def test_dark_and_saturated_pixels_are_not_measured():
    images = images_of(columns_seen(plane()))
    images[:, :40] = 5
    images[:, 80:] = np.minimum(images[:, 80:].astype(int) + 120, 255)
    found = decode(images, CORE, LIGHT, POSE, FRINGES)
    assert not found.measured[:38].any()
    assert not found.measured[82:].any()
    assert found.measured[45:75].mean() > 0.95


def test_another_number_of_images_is_refused():
    with pytest.raises(InputError, match="11 images of 12 pictures"):
        decode(np.zeros((11, 120, 160), np.uint8), CORE, LIGHT, POSE, FRINGES)


ONE = FringeSettings(fringes=(1.0,), steps=3)


@pytest.fixture(scope="module")
def scene() -> SimulatedScene:
    return SimulatedScene(
        tiny(
            "module",
            module=CUBES,
            rig={"size_px": (172, 142), "pitch_um": 49.1},
            projector={"size_px": (320, 200), "position_mm": (250.0, 0.0, 744.0)},
        )
    )


def measured(scene: SimulatedScene, travel_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) errors by a single broad fringe, and where the module is lit."""
    light = make_projector(scene.scenario.projector)
    images = render_sequence(
        scene, light, make_fringe_patterns(ONE, light.camera.size_px), travel_mm=travel_mm
    )
    pose = light.projector_from_world @ scene.station.core_from_world.inverse()
    settings = DecodeSettings(most_sigma_mm=100)
    found = decode(images, scene.station.rig.core_camera, light.camera, pose, ONE, settings)
    truth = trace_core_truth(replace(scene.world_at(0), projector=light), scene.station)
    return found.depth_mm - truth.depth_mm, truth.lit & (truth.label >= 10)


def test_a_module_at_rest_is_measured_and_a_moving_one_is_not(scene: SimulatedScene):
    rest, lit = measured(scene, 0.0)
    moving, _ = measured(scene, 15.0)
    assert np.isfinite(rest[lit]).mean() > 0.95
    assert np.nanmedian(np.abs(rest[lit])) < 5
    assert np.nanmedian(rest[lit]) == pytest.approx(0, abs=1)
    assert np.nanquantile(np.abs(moving[lit]), 0.9) > 3 * np.nanquantile(np.abs(rest[lit]), 0.9)
