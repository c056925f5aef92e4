"""``beltscape rectify``: pairs, geometry, measured row error, picture."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from beltscape.core.geometry.pose import Pose
from beltscape.files.images import read_image, write_image
from beltscape.files.rig_json import read_rig, write_rig
from tests.synthetic.demo import parse_json


def test_row_error_is_small_with_the_true_rig_and_a_moved_camera_is_named(
    run, cropped, cropped_rig, tmp_path
):
    """For pairs in any direction."""
    code, out, err = run(
        "rectify", cropped / "belt_loaded", "--rig", cropped_rig, "--out", tmp_path / "r", "--json"
    )
    assert code == 0
    assert not [line for line in err if line.startswith("warning")]
    pairs = parse_json(out)["frames"][0]["pairs"]
    assert [pair["auxiliary"] for pair in pairs] == ["cam1", "cam2", "cam3", "cam4"]
    for pair in pairs:
        assert pair["row_error"]["points"] >= 10
        assert abs(pair["row_error"]["median_px"]) < 0.1
        assert pair["row_error"]["rms_px"] < 0.2
        folder = tmp_path / "r" / "000" / pair["auxiliary"]
        size = tuple(pair["size_px"])
        assert read_image(folder / "core.png").shape[1::-1] == size
        assert read_image(folder / "auxiliary.png").shape[1::-1] == size
    assert json.loads((tmp_path / "r" / "000" / "rectification.json").read_text())["pairs"] == pairs
    plain = read_image(tmp_path / "r" / "000" / "rectification.png")
    assert plain.ndim == 3
    check_a_moved_camera(run, cropped, read_rig(cropped_rig), plain, tmp_path)


def check_a_moved_camera(run, cropped, rig, plain, tmp_path):
    tilted = Pose.of([0.006, 0.0, 0.0], [0.0, 0.0, 0.0]) @ rig.cam_from_core["cam1"]
    moved = replace(rig, cam_from_core={**rig.cam_from_core, "cam1": tilted})
    write_rig(tmp_path / "rig.json", moved)
    code, _, err = run(
        "rectify", cropped / "belt_loaded", "--rig", tmp_path / "rig.json", "--out", tmp_path / "m"
    )
    assert code == 0
    warned = [line for line in err if line.startswith("warning")]
    assert len(warned) == 1
    assert warned[0].startswith("warning: frame 000: cam1: it is ")
    assert "it moved or its lens changed" in warned[0]
    assert "is of another instant (synchronisation)" in warned[0]
    assert "; calibrate again" in warned[0]
    marked = read_image(tmp_path / "m" / "000" / "rectification.png")
    above = marked[: marked.shape[0] - plain.shape[0]]
    assert above.shape[0] > 0, "the warning is written above the pictures"
    assert (above.min(axis=2) < 128).any()


@pytest.mark.thorough
def test_camera_without_matches_is_unmatched(run, cropped_capture, cropped_rig, tmp_path):
    folder = cropped_capture("belt_loaded")
    path = folder / "cam3" / "000.png"
    write_image(path, np.ascontiguousarray(read_image(path)[::-1, ::-1]))
    code, out, err = run("rectify", folder, "--rig", cropped_rig, "--out", tmp_path / "r", "--json")
    assert code == 0
    warned = [line for line in err if line.startswith("warning")]
    assert warned == [
        "warning: frame 000: images turned by 180° (cam3): flipped back they fit the rig; "
        "switch the flip off in the camera's settings"
    ]
    frame = parse_json(out)["frames"][0]
    states = {each["camera"]: each["state"] for each in frame["consistency"]["cameras"]}
    assert states["cam3"] == "unmatched"
    assert frame["doubts"]
    assert frame["pairs"][2]["row_error"]["median_px"] is None
