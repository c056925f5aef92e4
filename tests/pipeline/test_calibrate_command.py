"""``beltscape calibrate`` and its warnings on the demo's images."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from beltscape.core.progress import Silent
from beltscape.files.images import read_image
from beltscape.files.rig_json import read_rig, write_rig
from beltscape.pipeline.calibrating import calibration
from beltscape.pipeline.calibrating.intrinsics import read_known_intrinsics
from beltscape.target.board import read_board
from tests.synthetic.demo import DEMO, TRUE_RIG, parse_json

CAMERAS = ("cam0", "cam1", "cam2")


@pytest.fixture
def boards(tmp_path):
    """Three cameras and six frames of the demo's board views."""
    for camera in CAMERAS:
        folder = tmp_path / "boards" / camera
        folder.mkdir(parents=True)
        for source in sorted((DEMO / "calibration" / camera).iterdir())[:6]:
            (folder / source.name).write_bytes(source.read_bytes())
    return tmp_path / "boards"


def calibrate(run, capture, out, *words):
    return run(
        "calibrate", capture, "--board", DEMO / "board.toml", "--core", "cam0", "--out", out, "--json", *words
    )


def test_frames_of_another_instant_are_reported(boards):
    files = sorted((boards / "cam1").iterdir())
    data = [path.read_bytes() for path in files]
    for path, content in zip(files, data[1:] + data[:1], strict=True):
        path.write_bytes(content)
    found = calibration.calibrate(boards, read_board(DEMO / "board.toml"), "cam0", Silent())
    assert list(found.warnings) == [
        "camera cam1: its frame numbers are 1 too low against cam0, cam2; rename its images; going on without cam1"
    ]
    assert list(found.rig.cameras) == ["cam0", "cam2"]


def test_mirrored_images_are_reported(boards):
    for path in (boards / "cam2").iterdir():
        cv2.imwrite(str(path), np.ascontiguousarray(read_image(path)[:, ::-1]))
    found = calibration.calibrate(boards, read_board(DEMO / "board.toml"), "cam0", Silent())
    assert f"{boards / 'cam2'}: the images are mirrored; switch mirroring off in the camera" in found.warnings


def test_square_given_in_inches_causes_a_warning(boards, tmp_path):
    board = tmp_path / "board.toml"
    text = (DEMO / "board.toml").read_text()
    board.write_text(text.replace("34.0", "1.34").replace("25.0", "0.984"))
    found = calibration.calibrate(boards, read_board(board), None, Silent())
    (warning,) = [line for line in found.warnings if "square_mm" in line]
    assert warning.startswith("with square_mm = 1.34 the board was 2")
    assert warning.endswith("mm apart; was it given in inches (34.04 mm)?")
    write_rig(tmp_path / "rig.json", found.rig)
    assert read_rig(tmp_path / "rig.json").core == found.rig.core  # what is written can be read


def test_given_intrinsics_are_fixed(boards):
    board, truth = read_board(DEMO / "board.toml"), read_rig(TRUE_RIG)
    known = read_known_intrinsics(TRUE_RIG, board, Silent())
    found = calibration.calibrate(boards, board, "cam0", Silent(), known=known).rig
    for name in CAMERAS:
        np.testing.assert_array_equal(found.cameras[name].focal_px, truth.cameras[name].focal_px)


def test_report_and_rig_are_those_of_the_demo(run, demo_run, tmp_path):
    """The same views give the same bytes in two runs."""
    capture, first = demo_run / "capture", demo_run / "out" / "calibration"
    assert calibrate(run, capture / "calibration", tmp_path / "again")[0] == 0
    for file in ("rig.json", "calibration.json", "report.html"):
        assert (tmp_path / "again" / file).read_bytes() == (first / file).read_bytes()


def test_the_certificate_of_a_board_is_part_of_every_sigma(boards, run, tmp_path):
    """The board is known to 0.1 %: σ of depth grows by as much, and the same board without it is the same board."""
    text = (DEMO / "board.toml").read_text()
    (tmp_path / "board.toml").write_text(f"{text}\nsquare_sigma_mm = 0.034\n")
    documents = {}
    for name, board in (("exact", DEMO / "board.toml"), ("certified", tmp_path / "board.toml")):
        words = "--board", board, "--core", "cam0", "--out", tmp_path / name, "--json"
        code, out, _ = run("calibrate", boards, *words)
        assert code == 0
        documents[name] = parse_json(out)
    rig = read_rig(tmp_path / "certified" / "rig.json")
    assert rig.scale_sigma == pytest.approx(1e-3)
    assert "scale_sigma" not in read_rig(tmp_path / "exact" / "rig.json").quality
    for plain, sized in zip(*(each["depth_sigma_mm"] for each in documents.values()), strict=True):
        assert sized["median"] == pytest.approx(np.hypot(plain["median"], 1e-3 * plain["depth_mm"]), rel=0.05)
        assert sized["median_by_views"] > plain["median_by_views"]
    assert "34 mm ± 0.034 mm" in (tmp_path / "certified" / "report.html").read_text()
    words = "--rig", tmp_path / "certified" / "rig.json", "--board", DEMO / "board.toml"
    code, _, err = run("check", boards, *words)
    assert code == 0
    assert not any("not described" in line for line in err)
