"""The trial plant: the shipped captures stand for cameras, board, empty belt and loads of known volume.

Its two loads are one instant each, rendered with exact truth, so that its certificate has no repetition; it shows how
a commissioning goes, not how good a plant is.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.commissioning.state import CommissionState, RunAnswer
from beltscape.commissioning.steps import EMPTY, MOVING, VIEWS, name_flow
from beltscape.files.atomic import write_text
from beltscape.files.capture import DEMO_FOLDER
from beltscape.files.json_text import read_json

CAPTURES = "trial"
"""Folder of the captures in the commissioning's folder."""
_SCENES = {VIEWS: "calibration", EMPTY: "belt_empty", MOVING: "belt_loaded", "module": "module"}
"""Capture of the trial → the shipped one."""
_LOADS = {MOVING: "rocks", "module": "module"}
"""Capture of a load of the material test → its name."""
_TRUTHS = {MOVING: "belt_loaded", "module": "module"}
_ENCODER = "frame,timestamp_s,belt_position_mm\n000,0,0\n"
"""A single instant."""
_SIGMA_PERCENT = 0.1
"""One standard deviation of the true volumes: their cross-sections are stated at every millimetre of belt."""


def make_trial(state: CommissionState) -> dict[str, Any]:
    """Copy the shipped captures into the folder, and return the settings of the trial plant."""
    folder, demo = state.folder / CAPTURES, DEMO_FOLDER
    for name, scene in _SCENES.items():
        if not (folder / name).is_dir():
            shutil.copytree(demo / scene, folder / name)
    for name in _LOADS:
        write_text(folder / name / "encoder.csv", _ENCODER)
    shutil.copy(demo / "board.toml", folder / "board.toml")
    shutil.copy(demo / "truth" / "volume.json", folder / "volume.json")
    return {
        "captures": CAPTURES,
        "board": {"file": f"{CAPTURES}/board.toml"},
        "plant": "Trial plant",
        "load_mm": 200.0,
        "density_kg_m3": 1600.0,
        "operator": "trial",
        "reference": {"name": "truth of the simulation", "sigma_percent": _SIGMA_PERCENT},
        "runs": [
            {"capture": f"{CAPTURES}/{name}", "load": load, "volume_m3": _read_whole_m3(folder, name)}
            for name, load in _LOADS.items()
        ],
    }


def _read_cross_sections(folder: Path, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the edges (n + 1,), mm along the belt, and the true volume (n + 1,) up to each, mm³."""
    truth = read_json(folder / "volume.json")["scenes"][_TRUTHS[name]]
    edges = truth["first_y_mm"] + np.arange(len(truth["area_mm2"]) + 1)
    return edges, np.concatenate([[0.0], np.cumsum(truth["area_mm2"])])


def _read_whole_m3(folder: Path, name: str) -> float:
    return float(_read_cross_sections(folder, name)[1][-1]) * 1e-9


def compute_true_m3(state: CommissionState, run: RunAnswer) -> float:
    """Return the true volume on the stretch of belt that a run's flow covers, m³."""
    edges, cumulated = _read_cross_sections(state.folder / CAPTURES, run.capture.name)
    strips = read_json(state.folder / name_flow(run) / "flow.json")["strips"]
    low, high = np.interp([strips[0]["start_mm"], strips[-1]["end_mm"]], edges, cumulated)
    return float(high - low) * 1e-9
