"""What ``calibrate`` and ``check`` write and print."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from beltscape.cli.main import main
from beltscape.files.rig_json import write_rig

pytestmark = pytest.mark.usefixtures("desk")


@pytest.mark.thorough
def test_calibrate_writes_rig_document_and_report_and_nothing_else(calibrate):
    assert calibrate() == (0, [])
    assert sorted(path.name for path in Path("out").iterdir()) == [
        ".beltscape.json",
        "calibration.json",
        "coverage.png",
        "report.html",
        "rig.json",
    ]
    document = json.loads(Path("out/calibration.json").read_text())
    assert document["format"] == "beltscape-calibration/1"
    assert document["cameras"]["cam0"]["board_seen"] == 5


@pytest.mark.parametrize("command", ["calibrate", "check"])
def test_json_is_one_document_on_standard_output_and_nothing_else(capfd, charuco_capture, command):
    write_rig(Path("rig.json"), charuco_capture.rig)
    Path("capture/cam1/03.png").unlink()
    rest = ["--out=out"] if command == "calibrate" else ["--rig=rig.json"]
    assert main([command, "capture", "--board=board.toml", *rest, "--json"]) == 0
    out, err = capfd.readouterr()
    document = json.loads(out)  # nothing before or behind it
    assert out.startswith("{")
    assert "capture/cam1: no image for frame 03; going on without" in document["warnings"]
    assert "warning: capture/cam1: no image for frame 03; going on without" in err


def test_an_error_with_json_is_one_document_and_one_line(capfd):
    assert main(["calibrate", "nowhere", "--board=board.toml", "--out=out", "--json"]) == 2
    out, err = capfd.readouterr()
    message = "nowhere: no such folder; a capture is <capture>/<camera>/<frame>.png"
    assert json.loads(out) == {"error": {"type": "InputError", "message": message, "exit_code": 2}}
    assert err == f"beltscape: {message}\n"
    assert not Path("out").exists()


def test_an_error_without_json_leaves_standard_output_empty(capfd):
    assert main(["calibrate", "nowhere", "--board=board.toml", "--out=out"]) == 2
    assert capfd.readouterr().out == ""
