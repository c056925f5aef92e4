"""Bad boards and captures: ``calibrate`` and ``check`` refuse them in one line."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from beltscape.cli.main import main
from beltscape.core.errors import CalibrationError, InputError
from beltscape.core.progress import Silent
from beltscape.files.rig_json import write_rig
from beltscape.pipeline.calibrating.calibration import calibrate
from beltscape.pipeline.calibrating.check import check
from beltscape.target.board import read_board

BOARD = 'kind = "charuco"\nsquares = [8, 6]\nsquare_mm = 40\nmarker_mm = 29\ndictionary = "DICT_4X4_50"\n'


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (("[8, 6]", "[3, 3]"), "squares = [3, 3] have 2×2 inner corners; a camera needs 8 at least"),
        (("[8, 6]", "[2, 20]"), "squares = [2, 20] have 1×19 inner corners"),
        (("40", "1e-9"), "square_mm = 1e-09: cannot be the edge of a board's square in mm (0.6 to 1000)"),
        (("40", "40000"), "square_mm = 40000: cannot be the edge of a board's square in mm (0.6 to 1000)"),
        (("40", "inf"), "square_mm = inf: must be a finite number"),
    ],
)  # fmt: skip
def test_a_board_that_cannot_be_calibrated_with_is_refused(tmp_path, change, line):
    path = tmp_path / "board.toml"
    path.write_text(BOARD.replace(*change))
    with pytest.raises(InputError) as error:
        read_board(path)
    assert str(error.value).startswith(f"{path}: ")
    assert line in str(error.value)


def test_a_camera_that_is_a_copy_of_another_is_named(tmp_path, charuco_capture):
    for name in ("left", "right"):
        shutil.copytree(charuco_capture.folder / "cam0", tmp_path / name)
    with pytest.raises(CalibrationError) as error:
        calibrate(tmp_path, charuco_capture.board, None, Silent())
    assert "cameras left and right stand at the same place" in str(error.value)


@pytest.fixture
def checked(tmp_path, charuco_capture, monkeypatch, capfd):
    """A function that checks the true rig with a board.toml and returns exit code, output and lines of error."""
    monkeypatch.chdir(tmp_path)
    for name in charuco_capture.rig.cameras:
        for frame in sorted((charuco_capture.folder / name).iterdir())[:4]:
            Path("capture", name).mkdir(parents=True, exist_ok=True)
            shutil.copy(frame, Path("capture", name))

    def checked(board: str, own: dict[str, object] | None) -> tuple[int, str, list[str]]:
        rig = charuco_capture.rig
        Path("board.toml").write_text(board)
        quality = {} if own is None else {"board": {**charuco_capture.board.model_dump(), **own}}
        write_rig(Path("rig.json"), type(rig)(rig.core, rig.cameras, rig.cam_from_core, quality))
        code = main(["check", "capture", "--rig", "rig.json", "--board", "board.toml"])
        out, err = capfd.readouterr()
        return code, out, [line for line in err.splitlines() if not line.endswith(" done")]

    return checked


def test_a_board_of_another_square_size_is_refused_with_both_values(checked):
    code, out, lines = checked(BOARD.replace("40", "35"), {})
    assert (code, out) == (2, "")
    assert lines[-1].startswith(
        "beltscape: capture: the board is given with square_mm = 35, but its squares measure 40"
    )
    assert lines[-1].endswith("(square_mm = 40): correct square_mm in board.toml")


@pytest.mark.parametrize(
    "own", [None, {"square_mm": 35.0}], ids=["no board in the rig", "the rig's is as wrong"]
)
def test_a_wrong_scale_is_measured_on_the_squares(checked, own):
    code, out, lines = checked(BOARD.replace("40", "35"), own)
    assert code == 0
    assert out.startswith("The fit is in doubt:\n- with this rig the board's squares measure 40")
    assert "(factor 1.14" in out
    assert len([line for line in lines if "in doubt" in line or "squares measure" in line]) == 1
    assert "moved" not in out  # the scale explains it all


def test_correct_board_causes_no_finding(checked):
    code, out, lines = checked(BOARD, {})
    assert (code, lines) == (0, [])
    assert out.startswith("4 frames, ")


def test_a_board_described_otherwise_is_stated(checked):
    code, out, lines = checked(BOARD.replace("29", "27"), {})
    assert code == 0
    assert lines == [
        "warning: the board is not described as the one the rig was calibrated with: marker_mm = 27.0 (the rig's: "
        "29.0); correct board.toml if it is the same board"
    ]
    assert "in doubt" not in out


def test_python_check_reports_the_same(tmp_path, charuco_capture):
    wrong = charuco_capture.board.model_copy(update={"square_mm": 44.0})
    found = check(str(charuco_capture.folder), charuco_capture.rig, wrong, Silent())
    assert found.scale == pytest.approx(40 / 44, rel=1e-3)
    assert not found.fit.is_sound
