"""Common fixtures: reproducible hypothesis, and the folder of optional data."""

from __future__ import annotations

import os
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = (
    "1"  # before numpy is loaded: its waiting threads take the other workers' time
)

import cv2
import pytest
from hypothesis import settings

from beltscape.target.board import CharucoBoard
from tests.once import make_once
from tests.synthetic.boards import BoardCapture, board_poses, capture, name_frames, row_of_cameras

settings.register_profile("beltscape", deadline=None, max_examples=30, derandomize=True)
settings.load_profile("beltscape")

cv2.setNumThreads(1)  # xdist already keeps every core busy

pytest_plugins = ["tests.collecting"]

REAL_DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "real"


SLOW_FOLDERS = {
    "calibration", "cli", "deploy", "docs", "evaluate", "measure", "pipeline", "report", "service", "simulate",
    "sinks", "sources", "stereo", "plan", "health", "tools", "benchmarks",
}  # fmt: skip
"""Folders of tests that work on whole captures or with other processes."""
BROWSER_FIXTURES = {"browser", "page", "chromium"}


def pytest_xdist_auto_num_workers() -> int:
    """Return one worker more than there are cores, because tests of cameras, servers and pages often wait."""
    return (os.cpu_count() or 1) + 1


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests by their folder and by the fixtures that they use."""
    root = Path(__file__).parent
    for item in items:
        if item.path.relative_to(root).parts[0] in SLOW_FOLDERS:
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
