"""A foreign object that is drawn into images of another renderer."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.simulate.faults.belt import ForeignObject
from beltscape.simulate.world import Projector, Station

CAMERA = Camera(
    "core", (200, 160), np.full(2, 300.0), np.array([99.5, 79.5]), np.array([-0.08, 0.0, 0.0, 0.0, 0.0])
)
RIG = Rig(
    "core",
    {"core": CAMERA, "side": replace(CAMERA, name="side")},
    {"core": Pose.identity(), "side": Pose.of(np.eye(3), [-60.0, 0.0, 0.0])},
)
ABOVE = Pose.of(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, 700.0])
"""Looks down on the belt's middle from 700 mm."""


@pytest.fixture
def drawing(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[2] / "benchmarks"))
    return import_module("faults.drawn_object")


def test_an_object_has_its_outline_and_its_lit_half_where_all_cameras_see_them(drawing):
    pattern = np.zeros((100, 100, 3), np.float32)
    pattern[:, 50:] = 1.0  # x > 0 of the world is lit
    lens = Camera("projector", (100, 100), np.full(2, 150.0), np.full(2, 49.5), np.zeros(5))
    projector, station = Projector(lens, ABOVE, pattern, power=1.0), Station(RIG, ABOVE)
    sound = {name: np.full((160, 200), 10, np.uint8) for name in RIG.cameras}
    plate = ForeignObject(first=0, size_mm=(120.0, 160.0, 5.0), above_mm=155.0, last=3)
    drawn = drawing.draw_objects(sound, station, projector, [plate], 1)
    for name, camera in RIG.cameras.items():
        corners = np.array([[x, y, 160.0] for x in (-60.0, 0.0, 60.0) for y in (-80.0, 80.0)])
        expected = camera.project(station.cam_from_world(name).apply(corners))
        row = drawn[name][round(expected[:, 1].mean())].astype(int)
        left, middle, right = expected[:, 0].reshape(3, 2).mean(axis=1)
        dark, lit = row < 8, row > 100
        assert abs(np.flatnonzero(dark)[0] - left) < 1.5 and abs(np.flatnonzero(dark)[-1] - middle) < 2.5
        assert abs(np.flatnonzero(lit)[0] - middle) < 2.5 and abs(np.flatnonzero(lit)[-1] - right) < 1.5
        assert (row[~dark & ~lit] == 10).mean() > 0.9
    gone = drawing.draw_objects(sound, station, projector, [plate], 4)
    assert all((gone[name] == sound[name]).all() for name in sound)
