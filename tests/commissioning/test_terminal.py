"""Guided calibration in the terminal, over SSH: views of a carried board, resumed, scored until it is enough."""

from __future__ import annotations

import json
import shutil
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from beltscape.cli.main import main
from beltscape.commissioning import guided, staged_cameras, trial
from beltscape.commissioning.guided import FIRST_SCORE, LEAST_VIEWS, GuidedSession
from beltscape.commissioning.live import LiveView, open_source
from beltscape.commissioning.staged_cameras import SimulatedBoard
from beltscape.commissioning.state import CommissionState
from beltscape.commissioning.steps import STEPS, get_status
from beltscape.core import system_calls
from beltscape.pipeline.calibrating.guidance import draw_ghost, outline_mm
from beltscape.pipeline.recording.shots import CornerCounter
from beltscape.target.board import corner_points_mm, read_board
from tests.once import make_once
from tests.synthetic.small_demo import make_small_demo

SHOWN_EVERY_S = staged_cameras.PERIOD_S
"""Time of a frame set, before tests shorten it."""


@pytest.fixture
def plant(tmp_path, tmp_path_factory, monkeypatch) -> Path:
    """A trial plant of the small demo, up to its board."""
    monkeypatch.setattr(
        trial, "DEMO_FOLDER", make_once(tmp_path_factory, "four_camera_demo", make_small_demo)
    )
    monkeypatch.setattr(staged_cameras, "PERIOD_S", 0.0)
    folder = tmp_path / "plant"
    assert (
        main(
            [
                "commission",
                str(folder),
                "--set",
                "source=trial",
                "--set",
                "tolerance_mm=0.2",
                "--step",
                "cameras",
            ]
        )
        == 0
    )
    assert main(["commission", str(folder), "--step", "board"]) == 0
    return folder


def test_views_are_taken_and_scored_until_it_is_enough(plant, capsys, monkeypatch):
    # the simulated board is too coarse in half the pixels: its views are never enough
    monkeypatch.setattr(trial, "open_board", lambda _: None)
    monkeypatch.setattr(guided, "SCORE_EVERY", 100)  # two scores: the first, and that of all views
    capsys.readouterr()
    assert main(["commission", str(plant), "--step", "calibrate", "--json"]) == 0
    out, err = capsys.readouterr()
    result = json.loads(out)["result"]
    views = len(list((plant / "calibration/cam0").glob("*.png")))
    assert LEAST_VIEWS <= views == result["views"]
    assert result["held_out_px"] < 0.05
    assert result["sigma_mm"] < 0.2  # of half the pixels
    assert f"view {FIRST_SCORE}" in err
    state = CommissionState(plant)
    assert [get_status(state, step) for step in STEPS[4:6]] == ["done", "open"]


def test_a_score_whose_document_is_larger_than_a_pipe_is_read(plant, tmp_path, monkeypatch):
    program = tmp_path / "program"  # a rig of five cameras has 80 kB
    program.write_text("#!/bin/sh\nhead -c 300000 /dev/zero | tr '\\0' ' '\n")
    program.chmod(0o755)
    monkeypatch.setattr(guided, "FIRST_SCORE", 1)
    monkeypatch.setattr(system_calls.sys, "executable", str(program))
    state = CommissionState(plant)
    session = GuidedSession(state, LiveView(lambda: open_source(state)))
    for frames in open_source(state):
        session.assess(frames)
        if session.taken:
            break
    assert session.is_scoring
    until = time.monotonic() + 60
    while session.is_scoring:
        assert time.monotonic() < until, "the program waits for somebody who reads"
        session.collect_score()
        time.sleep(0.05)
    session.close()


def test_a_session_goes_on_with_the_views_that_are_there(plant):
    state = CommissionState(plant)
    session = GuidedSession(state, LiveView(lambda: open_source(state)))
    source = open_source(state)
    for frames in source:
        session.assess(frames)
        if session.taken == 3:
            break
    session.close()
    again = GuidedSession(state, LiveView(lambda: open_source(state)))
    again.resume()
    assert again.taken == 3
    described = again.describe()
    assert described["taken"] == 3
    assert {name: len(rows) for name, rows in described["cells"].items()} == dict.fromkeys(source.cameras, 12)
    kept = again.set_aside()
    assert (kept.name, again.taken) == ("calibration_1", 0)
    assert len(list((kept / "cam0").glob("*.png"))) == 3
    assert not (plant / "calibration").exists()


def test_the_simulated_board_is_held_where_the_outline_is_drawn(plant):
    board = open_source(CommissionState(plant))
    assert isinstance(board, SimulatedBoard)
    target = read_board(plant / "board/board.toml")
    sizes = dict.fromkeys(board.cameras, (306, 256))
    wanted = draw_ghost(target, sizes, "cam0", None, 1)
    board.follow(wanted)
    shown = [frames for frames, _ in zip(board, range(2), strict=False)][-1]
    corners = CornerCounter(target).detect(shown.images)
    homography, _ = cv2.findHomography(
        corner_points_mm(target)[corners["cam0"].ids, :2], corners["cam0"].pixels
    )
    assert homography is not None
    outline = cv2.perspectiveTransform(outline_mm(target)[None, :, :2], homography)[0]
    assert np.abs(outline - np.array(wanted["cam0"])).mean() < 2.5  # the lens bends the outline
    board.close()


def test_without_views_the_step_says_so(plant, capsys, monkeypatch):
    monkeypatch.setattr(trial, "open_board", lambda _: None)
    shutil.rmtree(plant / "trial/calibration")
    assert main(["commission", str(plant), "--step", "calibrate"]) == 2
    assert "calibration" in capsys.readouterr().err


@pytest.mark.thorough
def test_the_trial_plant_comes_to_a_certificate_that_the_truth_confirms(tmp_path, monkeypatch, capsys):
    # the shipped captures: four cameras of half the pixels leave too much of the belt unmeasured
    monkeypatch.setattr(staged_cameras, "PERIOD_S", 0.0)
    boards, open_board = [], trial.open_board
    monkeypatch.setattr(trial, "open_board", lambda state: boards.append(open_board(state)) or boards[-1])
    plant = tmp_path / "plant"
    assert main(["commission", str(plant), "--set", "source=trial"]) == 0
    document: dict = {}
    for step in STEPS:
        capsys.readouterr()
        assert main(["commission", str(plant), "--step", "next", "--json"]) == 0, step.name
        document = json.loads(capsys.readouterr().out)
        assert document["step"] == step.name
    assert [one["status"] for one in document["steps"]] == ["done"] * len(STEPS)
    assert Path(plant / document["result"]["page"]).is_file()
    assert not boards[-1].is_exhausted
    assert boards[-1].shown * SHOWN_EVERY_S < 600, "from the first picture to enough in ten minutes"
    state = CommissionState(plant)
    record = state.get_record("material")
    assert record is not None
    for error in record["result"]["errors"]:
        assert abs(error["value"]) < 3 * error["sigma"], error
    (plant / "belt.json").write_text((plant / "belt.json").read_text() + "\n")
    assert [get_status(state, step) for step in STEPS[8:]] == ["outdated"] * 4
