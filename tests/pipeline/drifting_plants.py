"""A plant one of whose cameras was knocked: its history holds what the cameras showed before and after."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from beltscape.core.geometry.rig import Rig
from beltscape.files.belt_json import format_belt
from beltscape.files.json_text import hash_file
from beltscape.files.rig_json import write_rig
from beltscape.pipeline.live.drift import DriftMonitor
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from beltscape.stereo.consistency.drift import apply_drift
from tests.measure.flow.moving_belt import CAMERA, make_empty_belt
from tests.pipeline.certifying.plants import BEGIN_NS, SimulatedPlant
from tests.synthetic.drifting_rigs import find_points, make_rig, make_true_rig

HOUR_NS = 3600 * 10**9
KNOCK = {"cam2": np.array([8e-4, -8e-4, 0.0, 0.2, 0.0, 0.0, 0.0])}
HEIGHT_MM = 60.0


class DriftingPlant(SimulatedPlant):
    """A plant whose history also holds what its cameras showed."""

    def add_window(self, true: Rig, hour: int, seed: int) -> None:
        """Store a window of frames under a true rig."""
        rig, rng, seconds = make_rig(), np.random.default_rng(seed), iter(range(10**6))
        monitor = DriftMonitor(
            rig, hash_file(self.folder / "rig.json"), every_s=1.0, frames=24,
            monotonic_s=lambda: float(next(seconds)), wall_ns=lambda: BEGIN_NS + hour * HOUR_NS,
        )  # fmt: skip
        for _ in range(24):
            monitor.add(find_points(true, rng))
        historian = Historian(self.folder / "data", HistorySettings(reserve_mib=1))
        monitor.store(historian)
        historian.close()


def make_knocked_plant(folder: Path) -> DriftingPlant:
    """Return a plant with its reference, an estimate at rest, and one after `KNOCK`."""
    made = DriftingPlant(folder)
    write_rig(made.folder / "rig.json", make_rig())
    belt = make_empty_belt().belt
    (made.folder / "belt.json").write_text(format_belt(belt, CAMERA, []))
    text = made.path.read_text()
    if "rig =" not in text:
        made.path.write_text('rig = "rig.json"\nempty = "belt.json"\n' + text)
    made.pass_belt([HEIGHT_MM * (belt.across_mm[1] - belt.across_mm[0])] * 200)
    made.write_history()
    made.add_window(make_true_rig(), 1, 1)
    made.add_window(make_true_rig(), 24, 2)
    made.add_window(apply_drift(make_true_rig(), KNOCK), 48, 3)
    return made


def copy_plant(plant: DriftingPlant, folder: Path) -> DriftingPlant:
    """Return a copy that may be changed."""
    shutil.copytree(plant.folder, folder)
    return DriftingPlant(folder, project=folder / "project.toml")
