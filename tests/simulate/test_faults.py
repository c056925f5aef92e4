"""Simulated faults: each changes only what it describes."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.geometry.pose import Pose
from beltscape.simulate.faults import DeadProjector, Dirt, MissingFrames, MovedCamera, OverExposure
from beltscape.simulate.geometry.world import World
from beltscape.simulate.rendering.sensor import Sensor, expose
from tests.synthetic.light import DOWN, camera, plane, projector, station

ASIDE = Pose.of([0.1, 0.2, 0], [100, 0, 20]) @ DOWN


@pytest.fixture
def pair():
    return station(camera(), camera(name="cam1"), poses=(DOWN, ASIDE))


@pytest.mark.parametrize("name", ["cam0", "cam1"])
def test_only_the_moved_camera_moves(pair, name):
    knocked = MovedCamera(camera=name, rotation_deg=(0, 0.3, 0), shift_mm=(1.0, 0, -2.0)).apply(pair)
    for camera_name in pair.rig.cameras:
        before, after = pair.cam_from_world(camera_name), knocked.cam_from_world(camera_name)
        step = before.apply(after.center_mm)
        turn = (after @ before.inverse()).angle_deg
        np.testing.assert_allclose(step, (1, 0, -2) if camera_name == name else (0, 0, 0), atol=1e-9)
        assert turn == pytest.approx(0.3 if camera_name == name else 0.0, abs=1e-6)
    np.testing.assert_allclose(knocked.rig.cam_from_core["cam0"].rotation, np.eye(3))


def test_dead_projector_changes_nothing_else():
    world = World((plane(),), projector(np.ones((4, 4))), ambient=0.3)
    dark = DeadProjector().apply(world)
    assert dark.projector is None
    assert (dark.solids, dark.ambient) == (world.solids, 0.3)


def test_dirt_darkens_only_its_own_pixels():
    light = Dirt(camera="cam0", specks_px=((30.0, 20.0, 5.0),), opacity=0.6).apply(
        np.ones((50, 80, 3), np.float32)
    )
    assert light.dtype == np.float32
    np.testing.assert_allclose(light[20, 30], 0.4, rtol=1e-5)
    np.testing.assert_allclose(light[20, 45:], 1.0)


def test_over_exposure_saturates():
    sensor = Sensor()
    light = np.full((20, 20, 3), 0.5, np.float32)
    assert expose(light, sensor, 0).max() < 150
    assert expose(light, OverExposure(camera="cam0", factor=4.0).apply(sensor), 0).min() > 250


def test_frames_are_missing_in_one_camera_only():
    fault = MissingFrames(camera="cam2", every=3, first=1)
    assert [fault.delivers("cam2", frame) for frame in range(6)] == [True, False, True, True, False, True]
    assert all(fault.delivers("cam1", frame) for frame in range(6))
