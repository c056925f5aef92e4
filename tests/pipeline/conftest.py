"""Fixtures: the demo's capture, parts of it, and one run of the whole demo."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.once import make_once
from tests.synthetic.demo import DEMO, TRUE_RIG


@pytest.fixture
def capture(tmp_path):
    """A function scene → a copy of it, to be damaged."""

    def copy(scene: str) -> Path:
        return Path(shutil.copytree(DEMO / scene, tmp_path / scene))

    return copy


@pytest.fixture
def run(capsys):
    """A function that runs the program: exit code, standard output, lines on standard error."""
    from beltscape.cli.main import main

    def call(*words: object) -> tuple[int, str, list[str]]:
        capsys.readouterr()
        try:
            code = main([str(word) for word in words])
        except SystemExit as stop:
            code = int(stop.code or 0)
        captured = capsys.readouterr()
        return code, captured.out, captured.err.splitlines()

    return call


@pytest.fixture(scope="session")
def small_frames(tmp_path_factory):
    """Frame folders of the empty and the loaded belt: one pair of cameras, the true rig."""
    from beltscape.core.progress import Silent
    from beltscape.files.rig_json import read_rig
    from beltscape.pipeline.reconstructing.reconstruction import reconstruct_capture

    def make(out: Path) -> None:
        for scene in ("belt_empty", "belt_loaded"):
            reconstruct_capture(DEMO / scene, read_rig(TRUE_RIG), out / scene, Silent(), method="binocular")

    return make_once(tmp_path_factory, "small_frames", make)


@pytest.fixture(scope="session")
def small_belt(small_frames, tmp_path_factory):
    """The belt.json of the empty belt's frame."""
    from beltscape.core.progress import Silent
    from beltscape.pipeline.measuring.belt import measure_empty_belt, write_belt_files

    def make(out: Path) -> None:
        write_belt_files(out / "belt.json", *measure_empty_belt(small_frames / "belt_empty", None, Silent()))

    return make_once(tmp_path_factory, "small_belt", make) / "belt.json"
