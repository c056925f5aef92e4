"""The trial plant: the shipped captures stand for cameras, board, empty belt and loads of known volume.

Each of its two loads is one instant, rendered with exact truth. A repetition is the same instant with noise of its
own in every image. It shows how a commissioning goes, not how good a plant is.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.commissioning.staged_cameras import SimulatedBoard
from beltscape.commissioning.state import CommissionState, RunAnswer
from beltscape.commissioning.steps import EMPTY, MOVING, SKEW, VIEWS, name_flow
from beltscape.core.frames import Image, to_grey
from beltscape.core.geometry.pose import Pose, rotation_from_vector
from beltscape.core.geometry.rig import Rig
from beltscape.files.atomic import make_folder_once, write_bytes, write_text
from beltscape.files.capture import DEMO_FOLDER, read_capture
from beltscape.files.images import read_image, write_image
from beltscape.files.json_text import read_json
from beltscape.files.rig_json import read_rig
from beltscape.files.times_csv import append_time
from beltscape.simulate.board_pictures import BoardPictures
from beltscape.target.board import corner_points_mm, read_board
from beltscape.target.planar_boards import SquareBoard

RIG_FILE = "rig.json"
"""The true rig, before which the simulated board is carried; nothing else reads it."""
CAPTURES = "trial"
"""Folder of the captures in the commissioning's folder."""
_SCENES = {VIEWS: "calibration", EMPTY: "belt_empty", MOVING: "belt_loaded"}
"""Capture of the trial → the shipped one."""
_LOADS = {"rocks": "belt_loaded", "module": "module"}
"""Load of the material test → the shipped capture."""
_REPETITIONS, _NOISE_LEVELS = 2, 1.0
"""Runs of each load, and σ of the noise that the later ones get: about that of the images themselves."""
_RATE_HZ = 10.0
"""Instants a second of the swung board."""
_SWING_FILL = 0.5
"""Share of the core's image that it fills, so that all cameras see it."""
_ENCODER = "frame,timestamp_s,belt_position_mm\n000,0,0\n"
"""A single instant."""
_SIGMA_PERCENT = 0.1
"""One standard deviation of the true volumes: their cross-sections are stated at every millimetre of belt."""


ANSWERS = {"plant": "Trial plant", "density_kg_m3": 1600.0, "operator": "trial"}
"""Settings of the trial that stay as the engineer has answered them."""
OF_CAPTURES = frozenset({"captures", "board", "load_mm", "reference", "runs"})
"""Settings that belong to its captures."""


def make_trial(state: CommissionState) -> dict[str, Any]:
    """Copy the shipped captures into the folder, and return the settings of the trial plant."""
    folder = state.folder / CAPTURES
    for name, scene in _SCENES.items():
        make_folder_once(folder / name, lambda to, scene=scene: _copy(DEMO_FOLDER / scene, to))
    write_text(folder / MOVING / "encoder.csv", _ENCODER)
    for name in ("board.toml", "truth/volume.json", f"truth/{RIG_FILE}"):
        write_bytes(folder / Path(name).name, (DEMO_FOLDER / name).read_bytes())
    answered = {key: getattr(state.settings, key) for key in ANSWERS.keys() & state.settings.model_fields_set}
    return {
        **ANSWERS,
        **answered,
        "captures": CAPTURES,
        "board": {"file": f"{CAPTURES}/board.toml"},
        "load_mm": 200.0,
        "reference": {"name": "truth of the simulation", "sigma_percent": _SIGMA_PERCENT},
        "runs": [_make_run(folder, load, number) for number in range(_REPETITIONS) for load in _LOADS],
    }


def open_board(state: CommissionState) -> SimulatedBoard | None:
    """Return the simulated board before the trial's cameras; None in a folder of a version without one."""
    folder = state.folder / CAPTURES
    if not (folder / RIG_FILE).is_file():
        return None
    rig, board = _read_rig_and_board(folder)
    return SimulatedBoard(rig, board, _read_backgrounds(folder, rig))


def make_moving_board(state: CommissionState, instants: int) -> None:
    """Write the capture of a board that is swung before the trial's cameras, with the time of every instant."""
    folder = state.folder / CAPTURES
    rig, board = _read_rig_and_board(folder)

    def render(to: Path) -> None:
        pictures = BoardPictures(rig, board, _read_backgrounds(folder, rig))
        for number in range(instants):
            time_s = number / _RATE_HZ
            for name, image in pictures.render(swing_board(rig, board, time_s), number).items():
                write_image(to / name / f"{number:03d}.png", image)
            append_time(to, f"{number:03d}", round(time_s * 1e9))

    make_folder_once(folder / SKEW, render)


def swing_board(rig: Rig, board: SquareBoard, time_s: float) -> Pose:
    """Return where a board that is swung before the cameras of a rig is at a time; once in about two seconds."""
    points = corner_points_mm(board)
    lens, extent = rig.core_camera, np.ptp(points[:, 0])
    depth = float(lens.focal_px[0] * extent / (_SWING_FILL * lens.size_px[0]))
    away = np.sin(2 * np.pi * time_s * np.array([0.5, 0.37, 0.23]) + np.array([0.0, 1.0, 2.0]))
    tilt = np.sin(2 * np.pi * time_s * np.array([0.27, 0.21, 0.16]) + np.array([0.0, 1.6, 0.0]))
    rotation = rotation_from_vector(np.array([0.25, 0.25, 0.1]) * tilt)
    centre = depth * (np.array([0.0, 0.0, 1.0]) + np.array([0.15, 0.1, 0.06]) * away)
    return Pose.placing(rotation, points.mean(axis=0), centre)


def _read_rig_and_board(folder: Path) -> tuple[Rig, SquareBoard]:
    board = read_board(folder / "board.toml")
    assert isinstance(board, SquareBoard), "the board that ships"
    return read_rig(folder / RIG_FILE), board


def _read_backgrounds(folder: Path, rig: Rig) -> dict[str, Image]:
    """Return each camera's picture of the empty belt (H, W) uint8."""
    capture = read_capture(folder / EMPTY)
    files = {name: next(iter(capture.files[name].values())) for name in rig.cameras}
    return {name: np.rint(to_grey(read_image(path))).astype(np.uint8) for name, path in files.items()}


def _make_run(folder: Path, load: str, number: int) -> dict[str, Any]:
    """Copy a load's images as one run; in repetitions with noise of their own."""
    name = f"{load}_{number + 1}"

    def make(to: Path) -> None:
        _copy(DEMO_FOLDER / _LOADS[load], to)
        if number:
            _add_noise(to, number)

    make_folder_once(folder / name, make)
    write_text(folder / name / "encoder.csv", _ENCODER)
    whole_m3 = round(float(_read_cross_sections(folder, load)[1][-1]) * 1e-9, 6)  # to a millilitre
    return {"capture": f"{CAPTURES}/{name}", "load": load, "volume_m3": whole_m3}


def _add_noise(capture: Path, seed: int) -> None:
    """Add noise to all images of a capture."""
    rng = np.random.default_rng(seed)
    for path in sorted(capture.glob("*/*.png")):
        image = read_image(path)
        noisy = image + rng.normal(0.0, _NOISE_LEVELS, image.shape)
        write_image(path, np.clip(np.rint(noisy), 0, 255).astype(np.uint8))


def _copy(scene: Path, to: Path) -> None:
    shutil.copytree(scene, to)


def _read_cross_sections(folder: Path, load: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the edges (n + 1,), mm along the belt, and the true volume (n + 1,) up to each, mm³."""
    truth = read_json(folder / "volume.json")["scenes"][_LOADS[load]]
    edges = truth["first_y_mm"] + np.arange(len(truth["area_mm2"]) + 1)
    return edges, np.concatenate([[0.0], np.cumsum(truth["area_mm2"])])


def compute_true_m3(state: CommissionState, run: RunAnswer) -> float | None:
    """Return the true volume on the stretch of belt that a run's flow covers, m³; what was answered of other runs."""
    load = "" if run.capture is None else run.capture.name.rpartition("_")[0]
    if run.capture is None or run.capture.parent != Path(CAPTURES) or load not in _LOADS:
        return run.volume_m3
    edges, cumulated = _read_cross_sections(state.folder / CAPTURES, load)
    strips = read_json(state.folder / name_flow(run.capture) / "flow.json")["strips"]
    low, high = np.interp([strips[0]["start_mm"], strips[-1]["end_mm"]], edges, cumulated)
    return float(high - low) * 1e-9
