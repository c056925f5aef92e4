"""Flow on the rendered capture of a moving belt: motion and volume against the truth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.files.images import read_image
from beltscape.measure.belt.empty_belt import find_belt
from beltscape.measure.belt.reference import make_reference
from beltscape.measure.flow.meter import BeltFlowMeter, FramePlacement
from beltscape.measure.flow.settings import FlowSettings
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.settings import MultiviewSettings
from tests.stereo.rendered import RENDERED, needs_rendered, read_halved_frames, read_halved_rig

FRAMES = ("008", "009", "010")


def origin_y_mm(rotation: np.ndarray, translation: np.ndarray) -> float:
    """World y where the core camera's axis meets the flat belt, z = 0."""
    center, axis = -rotation.T @ translation, rotation[2]
    return float((center - axis * center[2] / axis[2])[1])


def moving(frame: str) -> FrameSet:
    folder: Path = RENDERED / "belt_moving"
    return FrameSet(frame, {f"cam{i}": read_image(folder / f"cam{i}/{frame}.png") for i in range(5)})


@pytest.mark.thorough
@needs_rendered
@pytest.mark.skipif(
    not (RENDERED / "belt_moving").is_dir(), reason="optional data: the moving capture is not there"
)
def test_motion_and_volume_of_rendered_frames_are_near_the_truth() -> None:
    rig = read_halved_rig()
    matcher = MultiviewReconstructor(rig, (560.0, 790.0), MultiviewSettings.preset("fast"))
    belt = find_belt(matcher.reconstruct(read_halved_frames("belt_empty"), Silent()), rig.core_camera)
    steps: list[FramePlacement] = []
    meter = BeltFlowMeter(make_reference(belt, rig.core_camera), FlowSettings(), watch_step=steps.append)
    truth = json.loads((RENDERED / "truth/belt_moving.json").read_text())
    true_frames = {f["frame"].removesuffix(".png"): f for f in truth["frames"]}
    records = []
    for frame in FRAMES:
        depth = matcher.reconstruct(moving(frame), Silent())
        records += meter.push(depth, round(true_frames[frame]["t"] * 1e9), frame=frame)
    records += meter.finish()
    assert meter.direction == 1
    places = np.array([true_frames[frame]["belt_position_mm"] for frame in FRAMES])
    measured = np.array([step.place.position_mm for step in steps])
    np.testing.assert_allclose(measured[1:] - measured[0], places[1:] - places[0], atol=0.3)
    core = json.loads((RENDERED / "truth/rig.json").read_text())["cameras"]["cam0"]
    origin = origin_y_mm(np.array(core["R"]), np.array(core["t"]))
    profile = np.load(RENDERED / "truth/belt_moving_profile.npz")
    place = float(profile["y_belt_first"]) + float(profile["step"]) * np.arange(len(profile["area_mm2"]))
    low, high = records[0].strip_mm[0], records[-1].strip_mm[1]
    # s = position - (world y - origin) and world y = own y + position, from the first frame on
    on = (place > origin - places[0] - high) & (place < origin - places[0] - low)
    expected = float(profile["area_mm2"][on].sum()) * float(profile["step"])
    assert meter.totals.volume_mm3 == pytest.approx(expected, rel=0.04)
    assert meter.totals.share > meter.totals.single_share + 0.05
