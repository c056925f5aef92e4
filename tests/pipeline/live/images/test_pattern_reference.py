"""The projected pattern is kept over restarts: a projector that moved while the system was off is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from beltscape.core.progress import Silent
from beltscape.health.images.projector_position import ProjectorMonitor
from beltscape.health.settings import HealthSettings
from beltscape.pipeline.live.learned_images import PATTERN_FILE, make_pattern_keeper, read_pattern
from tests.health.images.drawn_belt import RIG, STEP_MM, make_frame
from tests.measure.flow.moving_belt import Heap, depth_map, make_empty_belt

REFERENCE = make_empty_belt()
SETTINGS = HealthSettings(learning_frames=3)
HEAP = Heap(start_mm=-2000.0, end_mm=2000.0, half_width_mm=130.0)
KEY = {"rig": "aa", "empty belt": "bb", "image width": 320, "gain": {"cam0": 0.0}}


def check(monitor: ProjectorMonitor, number: int, **options) -> list[str]:
    found = monitor.check(make_frame(number, HEAP, **options), depth_map(HEAP, STEP_MM * number), ())
    return [one.check for one in found if one.is_fault]


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the file of a run that recognised the pattern."""
    path = tmp_path_factory.mktemp("data") / PATTERN_FILE
    monitor = ProjectorMonitor(RIG, REFERENCE, SETTINGS, keep=make_pattern_keeper(path, KEY, Silent()))
    for number in range(3):
        check(monitor, 8 * number)
        assert not path.exists()  # learned, but not recognised yet
    check(monitor, 24)
    return path.read_bytes()


@pytest.fixture
def path(stored: bytes, tmp_path: Path) -> Path:
    (tmp_path / PATTERN_FILE).write_bytes(stored)
    return tmp_path / PATTERN_FILE


def test_a_projector_moved_before_the_restart_is_named(path: Path) -> None:
    learned = read_pattern(path, KEY, Silent())
    assert learned is not None
    moved = ProjectorMonitor(RIG, REFERENCE, SETTINGS, learned)
    assert [check(moved, number, moved_mm=(4.0, 3.0)) for number in (40, 41)] == [[], ["projector_moved"]]
    sound = ProjectorMonitor(RIG, REFERENCE, SETTINGS, learned)
    assert [check(sound, number) for number in (40, 41)] == [[], []]


def test_a_pattern_of_another_system_is_named_and_not_used(path: Path) -> None:
    reporter = Silent()
    assert read_pattern(path, {**KEY, "rig": "other"}, reporter) is None
    assert len(reporter.warnings) == 1 and "learned anew" in reporter.warnings[0]


@pytest.mark.parametrize("damage", ["cut", "changed", "empty", "text"])
def test_a_damaged_file_is_named_and_not_used(path: Path, stored: bytes, damage: str) -> None:
    middle = len(stored) // 2
    changed = (
        stored[:middle] + bytes(byte ^ 0x55 for byte in stored[middle : middle + 8]) + stored[middle + 8 :]
    )
    path.write_bytes({"cut": stored[:middle], "changed": changed, "empty": b"", "text": b"{}"}[damage])
    reporter = Silent()
    assert read_pattern(path, KEY, reporter) is None
    (line,) = reporter.warnings
    assert line.startswith(str(path)) and line.endswith("learned anew from the next frames")


def test_a_pattern_is_learned_anew_on_request(path: Path) -> None:
    keep = make_pattern_keeper(path, KEY, Silent())
    monitor = ProjectorMonitor(RIG, REFERENCE, SETTINGS, read_pattern(path, KEY, Silent()), keep)
    path.unlink()
    monitor.learn_anew()
    found = [name for number in range(5) for name in check(monitor, 8 * number, moved_mm=(4.0, 3.0))]
    assert found == [] and path.is_file()
