"""Twenty cameras before one large board in few positions, from rendered images to the rig by ``calibrate``."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beltscape.cli.main import main
from beltscape.core.geometry.rig import Rig
from beltscape.evaluate.depth_scores import score_rig_against_truth
from beltscape.files.json_text import read_json
from beltscape.files.rig_json import read_rig
from beltscape.kernels import load
from beltscape.target.board import CharucoBoard
from tests.synthetic.boards import Print, capture
from tests.synthetic.camera_arrays import boards_before, like_cameras

pytestmark = pytest.mark.thorough

BOARD = CharucoBoard(squares=(15, 10), square_mm=40, marker_mm=30, dictionary="DICT_5X5_100")
TOML = """kind = "charuco"
squares = [15, 10]
square_mm = 40
marker_mm = 30
dictionary = "DICT_5X5_100"
"""
COUNT, SCALE = 20, 0.5
"""Cameras, and the size of their images over that of `like_cameras`."""


def scale_images(rig: Rig) -> Rig:
    cameras = {
        name: replace(
            camera,
            size_px=(round(camera.size_px[0] * SCALE), round(camera.size_px[1] * SCALE)),
            focal_px=camera.focal_px * SCALE,
            center_px=(camera.center_px + 0.5) * SCALE - 0.5,
        )
        for name, camera in rig.cameras.items()
    }
    return replace(rig, cameras=cameras)


def render_positions(folder: Path, count: int, tilt_rad: float, convergence: float) -> Rig:
    rig = scale_images(like_cameras(COUNT, 1, convergence))
    capture(folder, rig, BOARD, boards_before(rig, count, tilt_rad, 1), Print(blur_px=0.6, noise=1.5))
    return rig


@pytest.fixture(scope="module")
def five(tmp_path_factory) -> tuple[Path, Rig]:
    folder = tmp_path_factory.mktemp("five")
    return folder, render_positions(folder, 5, 0.4, 1.0)


def select_frames(folder: Path, out: Path, frames: Iterable[str]) -> Path:
    """Return a capture that holds links to some frames only."""
    for camera in folder.iterdir():
        (out / camera.name).mkdir(parents=True)
        for frame in frames:
            os.link(camera / f"{frame}.png", out / camera.name / f"{frame}.png")
    return out


def run_calibrate(folder: Path, tmp_path: Path) -> int:
    (tmp_path / "board.toml").write_text(TOML)
    words = "--board", tmp_path / "board.toml", "--core", "c09", "--out", tmp_path / "out"
    return main(["calibrate", str(folder), *map(str, words)])


def read_result(out: Path) -> tuple[Rig, Mapping[str, Any]]:
    document = read_json(out / "calibration.json")
    assert isinstance(document, dict)
    return read_rig(out / "rig.json"), document


@pytest.mark.parametrize(("positions", "depth_mm"), [(5, 0.05), (4, 0.06), (3, 0.12)])
def test_few_positions_of_one_board_determine_twenty_cameras(five, tmp_path, positions, depth_mm):
    """σ of focal lengths is that of their true errors; depth, off by one share all over, is within 2.5 σ."""
    folder, true = five
    views = select_frames(folder, tmp_path / "views", [f"{k:02d}" for k in range(positions)])
    assert run_calibrate(views, tmp_path) == 0
    rig, document = read_result(tmp_path / "out")
    assert next(iter(rig.cameras)) == "c09"
    assert len(rig.cameras) == COUNT
    assert document["fit"]["sound"]
    score = document["held_out"] or document["training"]
    assert score["rms_px"] < 0.03
    assert score["square_rms_mm"] < 0.012
    core = true.cam_from_core["c09"].inverse()
    placed = {name: true.cam_from_core[name] @ core for name in rig.cameras}
    expected = Rig("c09", {name: true.cameras[name] for name in rig.cameras}, placed)
    error_mm = score_rig_against_truth(rig, expected, load()).depth_rms_mm
    sigma_mm = document["depth_sigma_mm"][1]["median"]
    assert sigma_mm < depth_mm
    assert error_mm < 2.5 * sigma_mm
    off = [rig.cameras[name].focal_px[0] / expected.cameras[name].focal_px[0] - 1 for name in rig.cameras]
    sigma = [each["sigma"]["fx_px"] / each["focal_px"][0] for each in document["cameras"].values()]
    assert 0.4 < np.median(sigma) / np.sqrt(np.mean(np.square(off))) < 2.5


def test_three_parallel_positions_before_parallel_cameras_are_refused(tmp_path, capfd):
    render_positions(tmp_path / "views", 3, 0.01, 0.0)
    assert run_calibrate(tmp_path / "views", tmp_path) == 2
    assert not (tmp_path / "out" / "rig.json").exists()
    line = capfd.readouterr().err
    assert "the views do not determine the focal length of camera" in line
    assert "3 positions of the board, tilted by 1° at most, do not suffice" in line
