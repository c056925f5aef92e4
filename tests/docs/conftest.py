"""Fixtures of the manual's tests: the reader's files, and the folder in which the README was followed."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import pytest

from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from tests.docs.blocks import read_blocks
from tests.docs.reader import SCENES, Reader
from tests.docs.results import Results
from tests.docs.system import ROOT
from tests.docs.tables import check_table
from tests.once import make_once
from tests.sinks.ledgers import ledger
from tests.synthetic.small_demo import make_small_demo, shrink_images

SMALL = """[render]
oversample = 1
passes = 1
ambient_samples = 1
[heap]
rocks = 20
[heap.fines]
along_mm = [-100, 100]
"""
FRAMES = {"calibration": 1, "belt_moving": 2}
LATER = ("018", "019", "021", "022")
"""Views of the demo's board that the tutorial of calibration sets aside to check the rig with."""
FEWER = ("004.jpg", "010.jpg", "016.jpg")
"""Views of the board that only the README and the tutorials use."""
TUTORIAL_OF_RUNNING = "docs/tutorials/control_engineer.md"
"""Its scene of a moving belt is what the other pages measure: the demo's rig, whose lenses distort."""


def page_text(page: str) -> str:
    return (ROOT / page).read_text()


def make_material(folder: Path, demo: Path, results: Results) -> None:
    """Lay out the reader's own captures: board views, empty and loaded belt, module; the moving belt is rendered."""
    for scene, name in (("belt_empty", "empty"), ("belt_loaded", "loaded"), ("module", "module")):
        shutil.copytree(demo / scene, folder / name)
    later = shutil.ignore_patterns(*(f"{frame}.*" for frame in LATER))
    shutil.copytree(demo / "calibration", folder / "calibration", ignore=later)
    shutil.copytree(demo / "truth", folder / "truth")
    for name in ("board.toml", "module.toml"):
        shutil.copy(demo / name, folder / name)
    shutil.copytree(ROOT / "deploy", folder / "deploy", ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "scenes").mkdir()
    for scene in SCENES:
        frames = f"frames = {FRAMES.get(scene, 1)}\n"
        rig = "[rig]\nauxiliaries = 1\nscale = 0.125\n"
        (folder / "scenes" / f"{scene}.toml").write_text(f'kind = "{scene}"\n{frames}{rig}{SMALL}')
    reader = Reader(folder, results)
    for page, key in ((TUTORIAL_OF_RUNNING, "belt_moving"), ("docs/reference/project.md", 'rig = "rig')):
        blocks = read_blocks(page, page_text(page))
        check_table(next(one for one in blocks if one.kind == "toml" and key in one.text), folder)
    words = ["beltscape", "simulate", "moving.toml", "--out", "moving"]
    reader.attempt("moving", lambda: reader.command(words))
    assert reader.wrong == []


def make_day(folder: Path) -> None:
    """A plant's day file, of the day that the manual reads."""
    day_ns = 86_400_000_000_000
    start_ns = int(datetime(2026, 11, 21, tzinfo=UTC).timestamp()) * 1_000_000_000
    historian = Historian(folder / "past", HistorySettings(reserve_mib=1, database_days=1))
    historian.write(ledger(48, start_ns=start_ns, every_ns=day_ns // 24))
    historian.maintain(start_ns + 3 * day_ns)
    historian.close()
    (folder / "data/days").mkdir(parents=True)
    shutil.copy(folder / "past/days/2026-11-21.parquet", folder / "data/days")
    shutil.rmtree(folder / "past")


@pytest.fixture(scope="session")
def results(tmp_path_factory) -> Results:
    return Results(make_once(tmp_path_factory, "results", lambda _: None))


@pytest.fixture(scope="session")
def small_demo(tmp_path_factory) -> Path:
    """The capture that the manual's tests are run on in place of the demo's."""
    return make_once(tmp_path_factory, "four_camera_demo", make_small_demo)


@pytest.fixture(autouse=True)
def small_demo_ships(request, monkeypatch) -> None:
    """Let the folder that pages copy be the small capture's."""
    if "make_reader" in request.fixturenames or "walked" in request.fixturenames:
        folder = request.getfixturevalue("small_demo")
        monkeypatch.setattr("beltscape.demo_folder", lambda: folder, raising=False)


@pytest.fixture(scope="session")
def walked(tmp_path_factory, small_demo, results) -> tuple[Path, list[str], list[str]]:
    """The folder after the README, what did not hold, and what was run; made once, by the first worker."""

    def walk(folder: Path) -> None:
        make_material(folder, small_demo, results)
        reader = Reader(folder, results)
        reader.follow("README.md", page_text("README.md"))
        (folder / "reader.json").write_text(json.dumps([reader.wrong, reader.done]))

    folder = make_once(tmp_path_factory, "reader", walk)
    wrong, done = json.loads((folder / "reader.json").read_text())
    return folder, wrong, done


@pytest.fixture
def make_reader(request, results, tmp_path) -> Callable[[str], Reader]:
    """A function page → a reader: of a tutorial in an empty folder, else with what the README's steps left."""

    def make(page: str) -> Reader:
        kinds = {block.kind for block in read_blocks(page, page_text(page))}
        if "/tutorials/" not in page and kinds & {"sh", "python", "toml"}:
            folder, _, _ = request.getfixturevalue("walked")
            without = shutil.ignore_patterns("*.db*", "data", "reader.json", *FEWER)
            shutil.copytree(folder, tmp_path, ignore=without, dirs_exist_ok=True)
            if "scale_rig(rig, 0.5)" in page_text(page):
                shrink_images(tmp_path / "moving", 0.5)
        (tmp_path / "data").mkdir()
        if "data/days" in page_text(page):
            make_day(tmp_path)
        return Reader(tmp_path, results)

    return make
