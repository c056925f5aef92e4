"""Fixtures: a working folder with a capture, and the program run in it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from beltscape.cli.main import main

BOARD = 'kind = "charuco"\nsquares = [8, 6]\nsquare_mm = 40\nmarker_mm = 29\ndictionary = "DICT_4X4_50"\n'


@pytest.fixture
def desk(tmp_path, monkeypatch, charuco_capture) -> Path:
    """The working folder: capture/ of two cameras and five frames, board.toml and the true rig.json."""
    monkeypatch.chdir(tmp_path)
    for name in ("cam0", "cam1"):
        for frame in sorted((charuco_capture.folder / name).iterdir())[:5]:
            Path("capture", name).mkdir(parents=True, exist_ok=True)
            shutil.copy(frame, Path("capture", name))
    Path("board.toml").write_text(BOARD)
    return tmp_path


@pytest.fixture
def run(capfd):
    """A function that runs the program and answers exit code and lines on standard error, progress left out."""

    def run(*words: str) -> tuple[int, list[str]]:
        try:
            code = main(words)
        except SystemExit as stop:
            assert isinstance(stop.code, int)
            code = stop.code
        lines = capfd.readouterr().err.splitlines()
        return code, [line for line in lines if not line.endswith(" done")]

    return run


@pytest.fixture
def calibrate(run):
    def calibrate(*options: str, capture: str = "capture", board: str | None = None) -> tuple[int, list[str]]:
        if board is not None:
            Path("board.toml").write_text(board)
        return run("calibrate", capture, "--board", "board.toml", "--out", "out", *options)

    return calibrate
