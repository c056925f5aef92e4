"""``calibrate`` end to end on exact corners: the verdict on views that determine no rig, and notes in the results."""

from __future__ import annotations

import json

import numpy as np
import pytest

from beltscape.calibration.detection.corners import BoardDetections
from beltscape.calibration.detection.detector import PrintVariant
from beltscape.cli.main import main
from beltscape.files.images import write_image
from beltscape.pipeline.calibrating import calibration
from tests.synthetic.camera_arrays import BOARD, boards_before, detect, like_cameras


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Return a function that runs ``calibrate`` on given corners, and the exit code."""

    def run(seen: BoardDetections) -> int:

        for name, views in seen.views.items():
            for frame in views:
                write_image(tmp_path / "capture" / name / f"{frame}.png", np.zeros((2, 2), np.uint8))
        (tmp_path / "board.toml").write_text(
            f'kind = "chessboard"\ncorners = {list(BOARD.corners)}\nsquare_mm = {BOARD.square_mm}\n'
        )
        monkeypatch.setattr(
            calibration, "detect_rig_board", lambda *_args, **_options: (seen, PrintVariant())
        )
        return main(
            ["calibrate", str(tmp_path / "capture"), "--board", str(tmp_path / "board.toml"), "--out",
             str(tmp_path / "out")]
        )  # fmt: skip

    return run


def test_views_that_determine_no_rig_end_with_exit_code_2_and_no_rig(run, tmp_path, capfd):
    rig = like_cameras(3, 21, convergence=0.0)
    assert run(detect(rig, boards_before(rig, 3, 0.01, 21), 0.05, 21, bend_mm=0.5)) == 2
    assert not (tmp_path / "out" / "rig.json").exists()
    assert "photograph the board in 10 positions or more" in capfd.readouterr().err


def test_a_frame_left_out_is_stated_wherever_results_are_shown(run, tmp_path, capfd):

    rig = like_cameras(3, 6)
    bend = np.array([0.0, 0.0, 40.0, 0.0, 0.0, 0.0, 0.0])
    assert run(detect(rig, boards_before(rig, 7, 0.3, 6), 0.05, 6, bend)) == 0
    printed = capfd.readouterr()
    assert "frame 02 is left out in all cameras" in printed.err
    assert "1 of 7 frames" in printed.out
    document = json.loads((tmp_path / "out" / "calibration.json").read_text())
    assert list(document["left_out"]["frames"]) == ["02"]
    assert all(
        "the board never came to" in note for note in document["notes"]
    )  # seven boards, all in the middle
    page = (tmp_path / "out" / "report.html").read_text()
    assert "1 of 7 frames" in page
    for column in ("lens", "brown", "fisheye", "rational", "valid to px", "corners to px", "image to px"):
        assert f">{column}</th>" in page
    assert "By clusters of views" in page
    for each in document["depth_sigma_mm"]:
        assert 0.2 * each["median"] < each["median_by_views"] < 5 * each["median"]
    assert "median at " in page
    assert " of the view" in page
