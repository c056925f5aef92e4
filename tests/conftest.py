"""Common fixtures: reproducible hypothesis, and the folder of optional data."""

from __future__ import annotations

import os
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = (
    "1"  # before numpy is loaded: its waiting threads take the other workers' time
)
os.environ.setdefault("BELTSCAPE_CORES", "1")  # xdist already keeps every core busy

import cv2
import pytest
from hypothesis import settings

from beltscape.target.board import CharucoBoard
from tests.detection_store import use_detection_store
from tests.once import make_once
from tests.synthetic.boards import BoardCapture, board_poses, capture, name_frames, row_of_cameras
from tests.thorough import THOROUGH, count_examples

settings.register_profile("beltscape", deadline=None, max_examples=count_examples(30), derandomize=True)
settings.load_profile("beltscape")

cv2.setNumThreads(1)

pytest_plugins = ["tests.collecting"]

REAL_DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "real"


SLOW_FOLDERS = {
    "api", "benchmarks", "calibration", "cli", "commissioning", "deploy", "docs", "evaluate", "health", "measure",
    "pipeline", "plan", "report", "reprocessing", "service", "simulate", "sinks", "site", "sources", "stereo",
    "tools", "workers",
}  # fmt: skip
"""Folders of tests that work on whole captures or with other processes."""
BROWSER_FIXTURES = {"browser", "page", "chromium"}


LONG_FOLDERS = {"docs", "commissioning"}
"""Folders of tests that take up to half a minute; they are begun first, so that none is waited for alone."""


def pytest_xdist_auto_num_workers() -> int:
    """Return two workers more than there are cores, because tests of cameras, servers and pages often wait."""
    return (os.cpu_count() or 1) + 2


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave folders of slow tests alone where none of them is to run, instead of importing and deselecting them."""
    if "not slow" not in str(config.getoption("markexpr")).split(" and "):
        return None
    return _is_in(collection_path, SLOW_FOLDERS) or None


def _is_in(path: Path, folders: set[str]) -> bool:
    """Return whether a file or folder lies in one of these folders of tests, or is one."""
    return not folders.isdisjoint(path.relative_to(Path(__file__).parent).parts[:1])


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what only `make thorough` runs, put long tests first, mark tests by their folder and fixtures."""
    left_out = [item for item in items if item.get_closest_marker("thorough") and not THOROUGH]
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if not item.get_closest_marker("thorough")]
    items.sort(key=lambda item: not _is_in(item.path, LONG_FOLDERS))
    for item in items:
        if _is_in(item.path, SLOW_FOLDERS):
            item.add_marker("slow")
        if BROWSER_FIXTURES & set(getattr(item, "fixturenames", ())):
            item.add_marker("browser")


@pytest.fixture
def real_data():
    """A function name → folder of recorded data; the test is skipped where there is none."""

    def folder(name: str) -> Path:
        path = REAL_DATA / name
        if not path.is_dir():
            pytest.skip(f"optional data: ../shared/data/real/{name} is not there")
        return path

    return folder


@pytest.fixture(scope="session", autouse=True)
def detection_store(tmp_path_factory):
    """Find the board in an image once in a run of the tests."""
    with use_detection_store(make_once(tmp_path_factory, "detections", lambda _: None)):
        yield


@pytest.fixture(scope="session")
def charuco() -> CharucoBoard:
    return CharucoBoard(squares=(8, 6), square_mm=40, marker_mm=29, dictionary="DICT_4X4_50")


@pytest.fixture(scope="session")
def charuco_capture(tmp_path_factory, charuco) -> BoardCapture:
    """Three cameras in a row, eight frames of a ChArUco board; rendered once for all workers, written by none."""
    rig, poses = row_of_cameras(["cam0", "cam1", "cam2"]), board_poses(charuco, 8)

    def make(folder: Path) -> None:
        capture(folder, rig, charuco, poses)

    return BoardCapture(make_once(tmp_path_factory, "charuco", make), rig, charuco, name_frames(poses))
