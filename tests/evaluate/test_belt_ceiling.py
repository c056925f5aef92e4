"""What of a moving heap any frame could measure, against the truth of single frames."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.evaluate.belt_ceiling import MovingCeiling, read_moving_scene
from beltscape.simulate.core_truth import trace_core_truth
from beltscape.simulate.scenario import Scenario
from beltscape.simulate.scene_assembly import SimulatedScene
from beltscape.simulate.world import Label

PLANT = {
    "kind": "belt_moving",
    "frames": 3,
    "rig": {"scale": 0.0625, "auxiliaries": 2},
    "heap": {"rocks": 40, "fines": {"along_mm": [-200, 200]}},
    "motion": {"start_mm": -250},
}


@pytest.fixture(scope="module")
def scene() -> SimulatedScene:
    return SimulatedScene(Scenario.model_validate(PLANT))


@pytest.fixture(scope="module")
def ceiling(scene) -> MovingCeiling:
    return MovingCeiling(scene)


@pytest.mark.parametrize("frame", [0, 1, 2])
def test_a_frame_measures_what_its_true_pixels_say(scene, ceiling, frame):
    truth = trace_core_truth(scene.world_at(frame), scene.station)
    load = truth.label == Label.MATERIAL
    rays = scene.station.rig.core_camera.rays()[load]
    core = np.column_stack([rays, np.ones(len(rays))]) * truth.depth_mm[load][:, None]
    world = scene.station.core_from_world.inverse().apply(core)
    along = world[:, 1] - scene.heap_position_mm(frame)
    found = ceiling.find_measurable(world[:, 0], along, (scene.frame_name(frame),))
    expected = (truth.lit & (truth.views > 0))[load]
    assert 0.1 < expected.mean() < 0.999
    assert np.mean(found == expected) > 0.97  # the others lie below an overhang


def test_frames_add_up(scene, ceiling):
    x, y = (plane.ravel() for plane in np.meshgrid(np.linspace(-200, 200, 41), np.linspace(-250, 250, 51)))
    names = tuple(scene.frame_name(frame) for frame in range(3))
    single = [ceiling.find_measurable(x, y, (name,)) for name in names]
    np.testing.assert_array_equal(ceiling.find_measurable(x, y, names), np.any(single, axis=0))
    assert np.any(single, axis=0).mean() > max(one.mean() for one in single)


def test_without_light_nothing_is_measurable():
    scene = SimulatedScene(Scenario.model_validate({**PLANT, "speckle": False}))
    assert not MovingCeiling(scene).find_measurable(np.zeros(3), np.zeros(3), (scene.frame_name(1),)).any()


def test_a_truth_of_another_program_has_no_scene(tmp_path):
    assert read_moving_scene(tmp_path) is None
