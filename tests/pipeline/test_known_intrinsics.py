"""``calibrate --intrinsics``: names and sizes are matched to the capture, or refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.core.errors import InputError
from beltscape.core.geometry.camera import Camera
from beltscape.core.progress import Silent
from beltscape.files.capture import Capture
from beltscape.files.exchange import FORMATS, export_rig, read_intrinsics
from beltscape.files.rig_json import read_rig, write_rig
from beltscape.pipeline.calibrating.intrinsics import KnownIntrinsics
from beltscape.target.board import CharucoBoard
from tests.synthetic.boards import board_poses, row_of_cameras
from tests.synthetic.demo import DEMO, TRUE_RIG, parse_json
from tests.synthetic.detections import make_detections

BOARD = CharucoBoard(squares=(8, 6), square_mm=40, marker_mm=29, dictionary="DICT_4X4_50")
RIG = row_of_cameras(["a", "b", "c"])


def capture_of(*names: str) -> Capture:
    return Capture(Path("boards"), {name: {"00": Path(name, "00.png")} for name in names})


def make_known(*names: str, **named: Camera) -> KnownIntrinsics:
    return KnownIntrinsics({**{name: RIG.cameras[name] for name in names}, **named}, "lab.yaml")


@pytest.mark.parametrize(
    ("known_names", "camera_names"), [(("a",), ("x", "y")), (("a", "b", "c"), ("A", "cam_b"))]
)
def test_intrinsics_without_a_camera_of_the_capture_are_refused(known_names, camera_names):
    with pytest.raises(InputError) as error:
        make_known(*known_names).match_capture(capture_of(*camera_names), Silent())
    assert str(error.value) == (
        f"lab.yaml: holds intrinsics of {', '.join(known_names)}, boards has the cameras "
        f"{', '.join(camera_names)}: none is the same; name the cameras in the file as their folders are named"
    )


@pytest.mark.parametrize(
    ("known_names", "camera_names", "warnings"),
    [
        ("ab", "ab", []),
        ("abc", "ab", ["lab.yaml: also holds c, not in boards"]),
        (
            "ac", "abxc",
            ["lab.yaml: gives the intrinsics of a, c; those of b, x are estimated from the views"],
        ),
        (
            "ac", "ab",
            [
                "lab.yaml: gives the intrinsics of a; those of b are estimated from the views; it also holds c, "
                "which the capture does not have"
            ],
        ),
    ],
)  # fmt: skip
def test_cameras_without_given_intrinsics_are_named(known_names, camera_names, warnings):
    reporter = Silent()
    matched = make_known(*known_names).match_capture(capture_of(*camera_names), reporter)
    assert list(matched.cameras) == [name for name in known_names if name in camera_names]
    assert reporter.warnings == warnings


def test_other_image_size_is_refused_with_both_sizes():
    known = make_known("a", b=replace(RIG.cameras["b"], size_px=(960, 800)))
    with pytest.raises(InputError) as error:
        known.require_sizes({"a": (480, 400), "b": (480, 400), "c": (480, 400)})
    assert str(error.value) == (
        "lab.yaml: intrinsics of another image size (b for 960×800 px, its images have 480×400 px); give those of "
        "this size"
    )
    make_known("a", "b").require_sizes({"a": (480, 400)})  # b's images could not be read


@pytest.mark.parametrize("factor", [0.9, 1.08])
def test_intrinsics_of_another_lens_are_named(factor):
    seen = make_detections(RIG, BOARD, board_poses(BOARD, 8), 0.05)
    bent = RIG.cameras["b"].distortion + np.array([0.3 * factor, 0, 0, 0, 0])
    other = replace(RIG.cameras["b"], focal_px=RIG.cameras["b"].focal_px * factor, distortion=bent)
    known = make_known("a", b=other)
    chain = solve_hierarchy(seen, BOARD, "a", Silent(), known=known.cameras)
    found = known.find_foreign(chain, seen, BOARD)
    assert list(found) == ["b"]
    assert found["b"].startswith("lab.yaml: the intrinsics of b fit its views within ")
    true = make_known("a", "b")
    assert (
        true.find_foreign(solve_hierarchy(seen, BOARD, "a", Silent(), known=true.cameras), seen, BOARD) == {}
    )


@pytest.mark.parametrize("kind", FORMATS)
def test_every_format_gives_the_same_intrinsics(tmp_path, kind):
    path = tmp_path / {"colmap": "rig.json", "ros": "folder"}.get(kind, "rig.yaml")
    export_rig(path, RIG, kind, Silent())
    found = KnownIntrinsics(read_intrinsics(path), str(path)).match_capture(
        capture_of("a", "b", "c"), Silent()
    )
    for name, camera in RIG.cameras.items():
        assert found.cameras[name].size_px == camera.size_px
        np.testing.assert_allclose(found.cameras[name].focal_px, camera.focal_px, rtol=1e-12)


@pytest.fixture
def boards(tmp_path) -> Path:
    """Three cameras and six frames of the demo's board views."""
    for camera in ("cam0", "cam1", "cam2"):
        folder = tmp_path / "boards" / camera
        folder.mkdir(parents=True)
        for source in sorted((DEMO / "calibration" / camera).iterdir())[:6]:
            (folder / source.name).write_bytes(source.read_bytes())
    return tmp_path / "boards"


def test_refused_intrinsics_leave_no_files(run, boards, tmp_path):
    rig = read_rig(TRUE_RIG)
    names = {name: f"left_{name}" for name in rig.cameras}
    write_rig(
        tmp_path / "other.json",
        replace(
            rig, core=names[rig.core],
            cameras={names[n]: c for n, c in rig.cameras.items()},
            cam_from_core={names[n]: p for n, p in rig.cam_from_core.items()},
        ),
    )  # fmt: skip
    words = [
        "--board",
        DEMO / "board.toml",
        "--out",
        tmp_path / "out",
        "--intrinsics",
        tmp_path / "other.json",
    ]
    code, _, err = run("calibrate", boards, *words)
    assert code == 2
    assert f"{tmp_path / 'other.json'}: holds intrinsics of left_cam0, " in err[-1]
    assert not (tmp_path / "out" / "rig.json").exists()


def test_result_states_the_source_of_each_cameras_intrinsics(run, boards, tmp_path):
    rig = read_rig(TRUE_RIG)
    write_rig(tmp_path / "one.json", replace(rig, cameras={"cam0": rig.cameras["cam0"]}, cam_from_core={"cam0": rig.cam_from_core["cam0"]}))  # noqa: E501 # fmt: skip
    words = ["--board", DEMO / "board.toml", "--core", "cam1", "--intrinsics", tmp_path / "one.json"]
    code, out, _ = run("calibrate", boards, *words, "--out", tmp_path / "out", "--json")
    assert code == 0
    found = parse_json(out)
    assert {name: camera["intrinsics"] for name, camera in found["cameras"].items()} == {
        "cam0": "given", "cam1": "estimated", "cam2": "estimated",
    }  # fmt: skip
    assert f"{tmp_path / 'one.json'}: gives the intrinsics of cam0; those of cam1, cam2 are estimated from the views" in found["warnings"]  # noqa: E501 # fmt: skip
    assert found["cameras"]["cam0"]["held"] == ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"]
    document = json.loads((tmp_path / "out" / "calibration.json").read_text())
    assert document["fit"]["sound"] is True
    assert document["cameras"]["cam0"]["intrinsics"] == "given"
