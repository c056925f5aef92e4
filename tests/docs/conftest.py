"""Fixtures of the manual's tests: the reader's files, and the folder in which the README was followed."""

from __future__ import annotations

import fcntl
import json
import shutil
from datetime import UTC, datetime
from pathlib import Path

import pytest

from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from tests.docs.program import call
from tests.docs.reader import SCENES, Reader
from tests.docs.system import ROOT
from tests.docs.tables import recorded_project
from tests.sinks.ledgers import ledger
from tests.synthetic.demo import DEMO, TRUE_RIG

SMALL = "[render]\npasses = 1\nambient_samples = 1\n[heap]\nrocks = 60\n"
FRAMES = {"calibration": 1, "belt_moving": 2}
MOVING = f"""kind = "belt_moving"
frames = 3
[rig]
file = "{TRUE_RIG}"
height_mm = 744
scale = 0.5
[motion]
speed_mm_s = 1000
frames_per_s = 8
start_mm = -150
[heap]
rocks = 120
[render]
passes = 1
ambient_samples = 1
"""
"""The demo's rig, whose lenses distort, over the laboratory's belt while a heap passes."""


def page_text(page: str) -> str:
    return (ROOT / page).read_text()


def make_material(folder: Path) -> None:
    """Lay out the reader's own captures: board views, empty and loaded belt, module; the moving belt is rendered."""
    for scene, name in (("calibration", "calibration"), ("belt_empty", "empty"), ("belt_loaded", "loaded")):
        shutil.copytree(DEMO / scene, folder / name)
    shutil.copytree(DEMO / "module", folder / "module")
    for name in ("board.toml", "module.toml"):
        shutil.copy(DEMO / name, folder / name)
    shutil.copytree(ROOT / "deploy", folder / "deploy", ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "scenes").mkdir()
    for scene in SCENES:
        frames = f"frames = {FRAMES.get(scene, 1)}\n"
        rig = "[rig]\nauxiliaries = 1\n"
        (folder / "scenes" / f"{scene}.toml").write_text(f'kind = "{scene}"\n{frames}{rig}{SMALL}')
    (folder / "moving.toml").write_text(MOVING)
    answer = call(["simulate", "moving.toml", "--out", "moving"], folder)
    assert answer.code == 0, answer.err
    project = next(
        text for text in page_text("docs/reference/project.md").split("```toml\n") if text.startswith("name")
    )
    project = project.split("```")[0]
    (folder / "project.toml").write_text(project)
    (folder / "recorded.toml").write_text(recorded_project(project))


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
def walked(tmp_path_factory) -> tuple[Path, list[str], list[str]]:
    """The folder after the README, what did not hold, and what was run; made once, by the first worker."""
    shared = tmp_path_factory.getbasetemp()
    shared = shared.parent if shared.name.startswith("popen") else shared
    folder, record = shared / "reader", shared / "reader.json"
    with (shared / "reader.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not record.is_file():
            folder.mkdir()
            make_material(folder)
            reader = Reader(folder)
            reader.follow("README.md", page_text("README.md"))
            record.write_text(json.dumps([reader.wrong, reader.done]))
    wrong, done = json.loads(record.read_text())
    return folder, wrong, done


@pytest.fixture
def reader(walked, tmp_path) -> Reader:
    """A reader with a copy of what the README's steps left."""
    for entry in walked[0].iterdir():
        if entry.name == "data":  # the plant's; each page has its own
            continue
        if entry.is_dir():
            shutil.copytree(
                entry, tmp_path / entry.name, ignore=shutil.ignore_patterns("report.html", "*.db*")
            )
        else:
            shutil.copy(entry, tmp_path / entry.name)
    make_day(tmp_path)
    return Reader(tmp_path)
