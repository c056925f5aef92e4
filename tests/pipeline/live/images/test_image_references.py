"""What the cameras normally show is kept over restarts, for the rig and the empty belt that it was learned with."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.progress import Silent
from beltscape.health.images.monitor import ImageMonitor
from beltscape.health.reference import ImageReferences
from beltscape.health.settings import HealthSettings
from beltscape.pipeline.live.learned_images import (
    REFERENCES_FILE,
    LearnedImages,
    make_references_keeper,
    read_references,
)
from tests.health.images.speckled_belt import blur, make_frame, make_rig

SETTINGS = HealthSettings(learning_frames=3)
KEY = {"rig": "aa", "empty belt": "bb", "image width": 320}


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    """Return the file of a run that learned the cameras' normal images."""
    path = tmp_path / REFERENCES_FILE
    monitor = ImageMonitor(make_rig(), SETTINGS, keep=make_references_keeper(path, KEY, Silent()))
    for number in range(4):
        monitor.check_images(make_frame(number))
    return path


def test_a_restarted_monitor_compares_with_what_was_learned(stored: Path) -> None:
    """All cameras out of focus from the first frame on: only known images show it."""
    reporter = Silent()
    learned = read_references(stored, KEY, reporter)
    assert learned is not None and reporter.warnings == []
    assert set(learned.reference.cameras) == set(make_rig().cameras)
    blurred = make_frame(9, lambda _, light: blur(light, 2))

    def find(references: ImageReferences | None) -> set[str]:
        monitor = ImageMonitor(make_rig(), SETTINGS, references)
        return {one.check for one in monitor.check_images(blurred).findings if one.is_fault}

    assert "projector_focus" in find(learned) and "projector_focus" not in find(None)
    sound = ImageMonitor(make_rig(), SETTINGS, learned).check_images(make_frame(9))
    assert [one.text for one in sound.findings if one.is_fault] == []


def test_what_is_kept_is_exact(stored: Path) -> None:
    first = read_references(stored, KEY, Silent())
    assert first is not None
    light = {"cam1": np.full((32, 40), np.nan, np.float32), "cam2": np.zeros((32, 40), np.float32)}
    make_references_keeper(stored, KEY, Silent())(replace(first, window_light=light, light=-0.25))
    again = read_references(stored, KEY, Silent())
    assert again is not None and again.light == -0.25
    assert again.reference.has_speckle == first.reference.has_speckle
    for name, grid in light.items():
        np.testing.assert_array_equal(again.window_light[name], grid)
    for name, one in first.reference.cameras.items():
        np.testing.assert_array_equal(again.reference.cameras[name].level, one.level)
        assert again.reference.cameras[name].own_sharpness == one.own_sharpness


@pytest.mark.parametrize("name", KEY)
def test_references_of_another_system_are_named_and_not_used(stored: Path, name: str) -> None:
    reporter = Silent()
    assert read_references(stored, {**KEY, name: "other"}, reporter) is None
    assert reporter.warnings == [
        f"{stored}: the {name} changed since; they are learned anew from the next frames"
    ]


@pytest.mark.parametrize("damage", ["cut", "changed", "bytes", "other", "grid"])
def test_a_damaged_file_is_named_and_not_used(stored: Path, damage: str) -> None:
    text, reporter = stored.read_text(), Silent()
    document = json.loads(text)
    document["cameras"]["cam1"]["level"] = [[1.0]]
    del document["sha256"]
    stored.write_bytes(
        {
            "cut": text[: len(text) // 2].encode(),
            "changed": text.replace('"light": 0.0', '"light": 0.5').encode(),
            "bytes": b"\x00\xff\x00",
            "other": b"[1, 2]",
            "grid": json.dumps(document).encode(),
        }[damage]
    )
    assert read_references(stored, KEY, reporter) is None
    (line,) = reporter.warnings
    assert line.startswith(f"{stored}") and line.endswith("they are learned anew from the next frames")


def test_what_was_learned_is_forgotten_on_request(stored: Path) -> None:
    """A lens was changed: what is out of focus by the old references is normal from now on, also after a restart."""
    monitor = ImageMonitor(
        make_rig(),
        SETTINGS,
        read_references(stored, KEY, Silent()),
        make_references_keeper(stored, KEY, Silent()),
    )

    def check(number: int) -> set[str]:
        frame = make_frame(number, lambda _, light: blur(light, 1.2))
        return {one.check for one in monitor.check_images(frame).findings if one.is_fault}

    assert "projector_focus" in check(9)
    assert LearnedImages((monitor,), (stored, stored.with_name("none.npz"))).learn_anew()
    assert not stored.exists()
    assert [check(number) for number in range(10, 15)] == [set()] * 5
    assert stored.is_file()
    assert not LearnedImages().learn_anew()


def test_nothing_is_read_where_nothing_was_kept(tmp_path: Path) -> None:
    reporter = Silent()
    assert read_references(tmp_path / REFERENCES_FILE, KEY, reporter) is None and reporter.warnings == []
