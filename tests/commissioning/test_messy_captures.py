"""Recorded captures that are not as they should be: every step names the file or camera and the fix, and goes on."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from beltscape.commissioning import staged_cameras
from beltscape.commissioning.guided import take_views
from beltscape.commissioning.live import open_source
from beltscape.commissioning.runner import StepRun
from beltscape.commissioning.staged_cameras import CarriedBoard
from beltscape.commissioning.state import CommissionState
from beltscape.core.errors import InputError
from beltscape.core.progress import Silent
from beltscape.files.images import read_image, write_image
from tests.once import make_once
from tests.synthetic.small_demo import make_small_demo, shrink

OTHER_BOARD = """kind = "charuco"
squares = [8, 6]
square_mm = 40.0
marker_mm = 29.0
dictionary = "DICT_4X4_50"
"""


@pytest.fixture
def plant(tmp_path, tmp_path_factory, monkeypatch) -> CommissionState:
    """A commissioning of captures: an image of another size, a damaged one, a camera that never sees the board."""
    demo = make_once(tmp_path_factory, "four_camera_demo", make_small_demo)
    monkeypatch.setattr(staged_cameras, "PERIOD_S", 0.0)
    views = tmp_path / "mine/calibration"
    shutil.copytree(demo / "calibration", views)
    for camera in sorted(views.iterdir()):
        for path in sorted(camera.iterdir())[4:]:
            path.unlink()
    for number, path in enumerate(sorted((views / "cam3").iterdir())):  # it looks elsewhere
        noise = np.random.default_rng(number).integers(90, 120, read_image(path).shape)
        write_image(path, noise.astype(np.uint8))
    other = sorted((views / "cam0").iterdir())[2]
    write_image(other, shrink(read_image(other)))
    sorted((views / "cam1").iterdir())[0].write_bytes(b"no image")
    (views / "cam9").mkdir()
    (views / "cam2/notes.txt").write_text("swung by hand")
    state = CommissionState(tmp_path / "plant")
    state.change_settings({"source": "captures", "captures": str(tmp_path / "mine"), "core": "cam0"})
    (tmp_path / "plant/board").mkdir()
    shutil.copy(demo / "board.toml", tmp_path / "plant/board/board.toml")
    return state


def run(plant: CommissionState, step: str) -> tuple[dict, list[str]]:
    notes = Silent()
    return StepRun(plant, notes).run(step), notes.warnings


def test_files_and_cameras_that_cannot_be_used_are_named_and_the_steps_go_on(plant):
    facts, lines = run(plant, "cameras")
    assert facts["names"] == ["cam0", "cam1", "cam2", "cam3"]
    assert any("cam9: is empty; going on without it" in line for line in lines)
    assert any("cam2: 1 file .txt (notes.txt) cannot be read" in line for line in lines)
    facts, lines = run(plant, "images")
    assert facts["cameras"] == 4
    views = Path(plant.settings.captures) / "calibration"
    damaged, other = sorted((views / "cam1").iterdir())[0], sorted((views / "cam0").iterdir())[2]
    assert [line for line in lines if str(damaged) in line and "not a readable image" in line]
    width, height = read_image(other).shape[1::-1]
    (line,) = [line for line in lines if str(other) in line]
    assert f"{width}×{height} px, but cam0's other images have {2 * width}×{2 * height}" in line
    assert "record it again, or remove it" in line
    assert run(plant, "trigger")[0]["incomplete"] == 0


def test_views_are_taken_without_them_and_the_camera_that_never_sees_the_board_is_named(plant):
    notes = Silent()
    take_views(plant, notes)
    assert [line for line in notes.warnings if line.startswith("cam3: sees the board in no recorded view")]
    assert [line for line in notes.warnings if line.startswith("cam1: ") and "not a readable image" in line]
    taken = sorted((plant.folder / "calibration").glob("*/*"))
    assert len({path.name for path in taken}) >= 2
    assert len({read_image(path).shape for path in taken}) == 1  # whole files, and none of another size


def test_another_board_than_was_described_is_named_and_nothing_is_written(plant):
    (plant.folder / "board/board.toml").write_text(OTHER_BOARD)
    notes = Silent()
    with pytest.raises(
        InputError, match=r"no two cameras see the board of board/board\.toml at one instant"
    ) as caught:
        take_views(plant, notes)
    assert "(cam0, cam1, cam2, cam3: nowhere); give the board that was used" in str(caught.value)
    assert not (plant.folder / "calibration").exists()


def test_a_capture_none_of_whose_images_can_be_read_ends_with_the_first_of_them(plant, monkeypatch):
    monkeypatch.setattr("beltscape.commissioning.live._PATIENCE_S", 0.2)
    for path in (Path(plant.settings.captures) / "calibration").glob("cam*/*.*"):
        path.write_bytes(b"")
    source = open_source(plant)
    assert isinstance(source, CarriedBoard)
    assert len(source.list_left_out()) == 16
    assert {one.state for one in source.health().values()} == {"lost"}
    run(plant, "cameras")
    with pytest.raises(InputError, match=r"no im\w+.*cam0: .*the file is empty \(0 bytes\).*\(3 more\)"):
        run(plant, "images")
