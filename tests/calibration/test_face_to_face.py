"""Two cameras face to face with a two-sided board between them: no corner is seen by both, and this is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from beltscape.cli.main import main
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.files.json_text import read_json
from beltscape.files.rig_json import read_rig
from beltscape.target.board import CharucoBoard
from tests.synthetic.boards import board_poses, camera, capture

BOARD = CharucoBoard(squares=(8, 6), square_mm=40, marker_mm=29, dictionary="DICT_4X4_50")
TOML = 'kind = "charuco"\nsquares = [8, 6]\nsquare_mm = 40\nmarker_mm = 29\ndictionary = "DICT_4X4_50"\n'


def test_a_rig_without_common_corners_is_scored_in_px_only(tmp_path, capfd):
    turn = Pose.of([0.0, np.pi, 0.0], np.zeros(3)).rotation
    poses = {"top": Pose.identity(), "under": Pose(turn, -turn @ np.array([20.0, 0.0, 1400.0]))}
    rig = Rig("top", {"top": camera("top"), "under": replace(camera("under"), name="under")}, poses)
    capture(tmp_path / "views", rig, BOARD, board_poses(BOARD, 10))
    (tmp_path / "board.toml").write_text(TOML)
    words = ["--board", str(tmp_path / "board.toml"), "--core", "top", "--out", str(tmp_path / "out")]
    assert main(["calibrate", str(tmp_path / "views"), *words]) == 0
    said = capfd.readouterr()
    assert "nan" not in said.out
    assert "px median, no square seen by two cameras" in said.out
    assert "no two cameras see the same corner at one instant, so that no length was measured" in said.err
    document = read_json(tmp_path / "out/calibration.json")
    assert document["held_out"]["square_rms_mm"] is None
    report = (tmp_path / "out/report.html").read_text()
    assert "and no square was seen by two cameras" in report
    assert ">nan" not in report
    assert "nan mm" not in report
    found = read_rig(tmp_path / "out/rig.json").cam_from_core["under"].center_mm
    assert np.linalg.norm(found - [20.0, 0.0, 1400.0]) < 1.5
    words = ["--board", str(tmp_path / "board.toml"), "--rig", str(tmp_path / "out/rig.json")]
    assert main(["check", str(tmp_path / "views"), *words]) == 0
    said = capfd.readouterr()
    assert "nan" not in said.out
    assert "square edge    not measured: no two cameras see the same corner" in said.out
