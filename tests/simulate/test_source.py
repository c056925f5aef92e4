"""The simulated frame source delivers what a simulated capture would contain."""

from __future__ import annotations

from itertools import islice

import numpy as np

from beltscape.core.progress import Silent
from beltscape.files.capture import read_capture
from beltscape.files.images import read_image
from beltscape.pipeline.simulation import simulate
from beltscape.simulate.scene_assembly import SimulatedSource
from tests.simulate.tiny import tiny

PAIR = {"auxiliaries": 1}
SCENE = tiny("belt_moving", frames=2, speckle=False, rig=PAIR, motion={"start_mm": 0.0, "speed_mm_s": 400.0})


def test_source_yields_the_frames_of_the_capture(tmp_path):
    simulate(SCENE, tmp_path / "capture", Silent())
    capture = read_capture(tmp_path / "capture")
    source = SimulatedSource(SCENE)
    assert source.cameras == capture.cameras
    assert len(source) > 10**9  # endless unless limited
    assert len(SimulatedSource(SCENE, frames=2)) == 2
    frames = list(islice(source, 2))
    assert [frame.time_ns for frame in frames] == [0, 200_000_000]
    assert tuple(frame.frame for frame in frames) == capture.frames
    for frame in frames:
        assert tuple(frame.images) == capture.cameras
        for name, image in frame.images.items():
            np.testing.assert_array_equal(image, read_image(capture.files[name][frame.frame]))


def test_calibration_repeats_from_its_first_pose():
    board = tiny("calibration", frames=1, rig=PAIR)
    first, again = SimulatedSource(board, frames=2)
    assert (first.frame, again.frame) == ("000", "001")
    change = again.images["cam0"].astype(float) - first.images["cam0"]
    assert 0 < change.std() < 5  # noise
