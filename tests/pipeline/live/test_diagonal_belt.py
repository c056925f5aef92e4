"""A rig that stands diagonally over the belt: each millimetre once, the right volume, no cell lost at skewed ends."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.ledger import BeltRecord
from beltscape.core.progress import Silent
from beltscape.files.belt_json import read_belt, write_belt
from beltscape.files.rig_json import read_rig
from beltscape.pipeline.live.assembly import RunOptions, assemble
from beltscape.pipeline.measuring.belt import read_empty_belt
from beltscape.pipeline.reconstructing.reconstruction import reconstruct_capture
from beltscape.pipeline.simulation import simulate
from beltscape.service.project import open_project
from tests.pipeline.live.feed import Watcher
from tests.simulate.tiny import tiny
from tests.thorough import list_cases

SPEED_MM_S = 640.0
HEAP = {"rocks": 12, "fines": {"along_mm": (-250.0, 250.0), "cell_mm": 12.0}}
PROJECT = """rig = "rig.json"
empty = "belt.json"
[capture]
folder = "moving"
[encoder]
kind = "capture"
[history]
reserve_mib = 1
"""


class Listening(Watcher):
    """Keeps the warnings."""

    def __init__(self) -> None:
        super().__init__()
        self.messages: list[str] = []

    def on_message(self, message: str) -> None:
        self.messages.append(message)


def make_plant(folder: Path, yaw_deg: float) -> Path:
    """Return the project of a plant with a moving belt, whose empty belt was learned by the diagonal rig itself."""
    rig = {"yaw_deg": yaw_deg}
    motion = {"speed_mm_s": SPEED_MM_S, "frames_per_s": 8.0}
    simulate(tiny("belt_moving", rig=rig, motion=motion, heap=HEAP), folder / "moving", Silent())
    simulate(tiny("belt_empty", rig=rig), folder / "empty_images", Silent())
    (folder / "rig.json").write_bytes((folder / "moving" / "truth" / "rig.json").read_bytes())
    own = read_rig(folder / "rig.json")
    reconstruct_capture(folder / "empty_images", own, folder / "empty", Silent(), preset="fast")
    write_belt(folder / "belt.json", *read_empty_belt(folder / "empty" / "000", Silent()))
    (folder / "project.toml").write_text(PROJECT)
    return folder / "project.toml"


def replay(project: Path) -> tuple[list[BeltRecord], Listening]:
    watcher = Listening()
    options = RunOptions(project.parent / "data", paced=False, record=False)
    assembled = assemble(open_project(project), options, watcher)
    assembled.engine.start()
    assert assembled.engine.wait(600)
    assert assembled.engine.stop() == 0
    assembled.close()
    return watcher.records, watcher


@pytest.mark.parametrize("yaw_deg", list_cases([35.0, -45.0], [35.0]))
def test_every_millimetre_counts_once_under_a_diagonal_rig(tmp_path: Path, yaw_deg: float) -> None:
    project = make_plant(tmp_path, yaw_deg)
    along = read_belt(tmp_path / "belt.json")[0].belt_from_core.rotation[1]
    station = json.loads((tmp_path / "moving/truth/station.json").read_text())
    travel = np.array(station["core_from_world"]["rotation"])[:, 1]
    assert abs(along @ travel) > np.cos(np.deg2rad(0.3))
    assert np.rad2deg(np.arccos(abs(travel[1]))) == pytest.approx(
        abs(yaw_deg), abs=3.0
    )  # mounted within 0.7°, 1 σ
    records, watcher = replay(project)
    assert watcher.messages == []
    for before, after in pairwise(records):
        assert after.belt_mm[0] == before.belt_mm[1]
    truth = json.loads((tmp_path / "moving/truth/belt_moving.json").read_text())
    travel_mm = truth["frames"][-1]["belt_position_mm"] - truth["frames"][0]["belt_position_mm"]
    assert records[-1].belt_mm[1] - records[0].belt_mm[1] == pytest.approx(travel_mm, abs=1.0)
    assert {record.standing for record in records} == {"valid"}
    error_mm3 = watcher.totals.volume_mm3 - truth["heap_volume_mm3"]
    assert abs(error_mm3) < 2 * watcher.totals.sigma_mm3
    assert abs(error_mm3) < 0.03 * truth["heap_volume_mm3"]
    # a row of the belt is in view by parts, from the one end of the view to the other: frames complete each other
    assert min(one.strip.coverage for one in records[1:-1] if one.strip is not None) > 0.85
