"""A small plant with three recordings of a moving belt, which follow each other without a pause."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from beltscape.cli.main import main
from beltscape.core.progress import Silent
from beltscape.files.belt_json import write_belt
from beltscape.files.rig_json import read_rig
from beltscape.pipeline.measuring.belt import read_empty_belt
from beltscape.pipeline.reconstructing.reconstruction import reconstruct_capture
from beltscape.pipeline.simulation import simulate
from tests.charts import leave_out_narrow_charts
from tests.once import make_once
from tests.simulate.tiny import tiny
from tests.synthetic.demo import parse_json

FRAMES, RECORDINGS = 9, 3
STEP_MM = 50.0
"""Travel of the belt between two frames."""
_RIG = {"size_px": (200, 165), "pitch_um": 3.45 * 12.24}
_HEAP = {"rocks": 6, "fines": {"along_mm": (-400.0, 400.0), "cell_mm": 12.0}}
_PROJECT = """rig = "rig.json"
empty = "belt.json"
[capture]
folder = "moving"
[encoder]
kind = "capture"
[density]
kg_m3 = 1500
sigma_kg_m3 = 30
[history]
reserve_mib = 1
"""


Run = Callable[..., tuple[int, str, list[str]]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run the program; return its exit code, its standard output and the lines of its standard error."""

    def run(*arguments: object) -> tuple[int, str, list[str]]:
        code = main([str(argument) for argument in arguments])
        printed = capsys.readouterr()
        return code, printed.out, printed.err.splitlines()

    return run


@pytest.fixture
def reprocess(run: Run, recorded_plant: Path, tmp_path: Path) -> Callable[..., dict[str, Any]]:
    """Run the command; return what --json prints."""

    def reprocess(
        source: object = "recordings", *options: object, store: str = "store", project: Path | None = None
    ) -> dict[str, Any]:
        with leave_out_narrow_charts():
            code, out, err = run(
                "reprocess", recorded_plant / str(source), "--project", project or recorded_plant / "project.toml",
                "--out", tmp_path / store, *options, "--json",
            )  # fmt: skip
        assert code == 0, err
        return parse_json(out)

    return reprocess


@pytest.fixture(scope="session")
def recorded_plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """project.toml, the capture ``moving``, and ``recordings/all`` with the same frames; no test writes into it."""
    return make_once(tmp_path_factory, "recorded_plant", _make_plant)


@pytest.fixture(scope="session")
def joined_store(tmp_path_factory: pytest.TempPathFactory, recorded_plant: Path) -> Path:
    """The store of the three recordings, measured in one process."""
    return _make_store(tmp_path_factory, recorded_plant, "recordings")


@pytest.fixture(scope="session")
def moving_store(tmp_path_factory: pytest.TempPathFactory, recorded_plant: Path) -> Path:
    """The store of the capture ``moving``, which is one recording."""
    return _make_store(tmp_path_factory, recorded_plant, "moving")


def _make_store(factory: pytest.TempPathFactory, plant: Path, source: str) -> Path:
    def make(folder: Path) -> None:
        words = ("reprocess", plant / source, "--project", plant / "project.toml")
        assert main([*map(str, words), "--out", str(folder / "store")]) == 0

    return make_once(factory, f"store_of_{source}", make) / "store"


def _make_plant(folder: Path) -> None:
    motion = {"speed_mm_s": 8 * STEP_MM, "frames_per_s": 8.0}
    simulate(
        tiny("belt_moving", frames=FRAMES, rig=_RIG, motion=motion, heap=_HEAP), folder / "moving", Silent()
    )
    simulate(tiny("belt_empty", rig=_RIG), folder / "empty_images", Silent())
    shutil.copy(folder / "moving" / "truth" / "rig.json", folder / "rig.json")
    reconstruct_capture(
        folder / "empty_images", read_rig(folder / "rig.json"), folder / "empty", Silent(), preset="fast"
    )
    write_belt(folder / "belt.json", *read_empty_belt(folder / "empty" / "000", Silent()))
    shutil.rmtree(folder / "moving" / "truth")
    (folder / "project.toml").write_text(_PROJECT)
    header, *rows = (folder / "moving" / "encoder.csv").read_text().splitlines()
    each = FRAMES // RECORDINGS
    for index in range(RECORDINGS):
        recording = folder / "recordings" / "all" / f"{index + 1:06d}-20261122T10000{index}Z"
        own = rows[each * index : each * (index + 1)]
        for camera in (path for path in (folder / "moving").iterdir() if path.is_dir()):
            (recording / camera.name).mkdir(parents=True)
            for row in own:
                name = f"{row.split(',')[0]}.png"
                shutil.copy(camera / name, recording / camera.name / name)
        (recording / "encoder.csv").write_text("\n".join([header, *own]) + "\n")
