"""Cameras added to a rig, or calibrated anew in it, with all others held."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from beltscape.core.errors import CalibrationError, InputError
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.files.images import write_image
from beltscape.files.rig_json import read_rig, write_rig
from beltscape.files.rig_limits import find_corner_radius_px
from beltscape.pipeline.calibrating.extension import extend_rig
from tests.synthetic.demo import parse_json

BOARD = 'kind = "charuco"\nsquares = [8, 6]\nsquare_mm = 40\nmarker_mm = 29\ndictionary = "DICT_4X4_50"\n'


def part_of(rig: Rig, *names: str) -> Rig:
    return Rig(
        rig.core, {n: rig.cameras[n] for n in names}, {n: rig.cam_from_core[n] for n in names},
        covariance={"parameters": ["cam1.fx_px"], "matrix": [[0.25]]},
    )  # fmt: skip


def assert_near_truth(found: Rig, true: Rig, name: str) -> None:
    names = list(found.covariance["parameters"])
    sigma = np.sqrt(np.diag(np.asarray(found.covariance["matrix"])))
    focal_sigma = sigma[names.index(f"{name}.fx_px")]
    assert 0 < focal_sigma < 1
    assert abs(found.cameras[name].focal_px[0] - true.cameras[name].focal_px[0]) < 5 * focal_sigma
    apart = found.cam_from_core[name].center_mm - true.cam_from_core[name].center_mm
    assert np.linalg.norm(apart) < 0.5


def test_a_camera_is_added_and_the_others_are_kept(charuco_capture, run, tmp_path):
    true = charuco_capture.rig
    write_rig(tmp_path / "two.json", part_of(true, "cam0", "cam1"))
    (tmp_path / "board.toml").write_text(BOARD)
    words = "--board", tmp_path / "board.toml", "--add-to", tmp_path / "two.json", "--out", tmp_path / "out"
    code, out, _ = run("calibrate", charuco_capture.folder, *words, "--json")
    assert code == 0
    result, rig = parse_json(out), read_rig(tmp_path / "out" / "rig.json")
    assert (result["new"], result["held"]) == (["cam2"], ["cam0", "cam1"])
    assert result["fit"]["sound"]
    assert result["held_out"]["rms_px"] < 0.1
    for name in ("cam0", "cam1"):
        np.testing.assert_array_equal(rig.cameras[name].focal_px, true.cameras[name].focal_px)
        np.testing.assert_array_equal(rig.cam_from_core[name].rotation, true.cam_from_core[name].rotation)
    assert_near_truth(rig, true, "cam2")
    names = list(rig.covariance["parameters"])
    # the former covariance is kept
    assert rig.covariance["matrix"][names.index("cam1.fx_px")][names.index("cam1.fx_px")] == 0.25


def test_a_camera_is_replaced_without_views_of_the_core(charuco_capture, tmp_path):
    true = charuco_capture.rig
    for name in ("cam1", "cam2"):
        shutil.copytree(charuco_capture.folder / name, tmp_path / name)
    wrong = part_of(true, "cam0", "cam1", "cam2")
    wrong.cameras["cam2"] = true.cameras["cam0"]  # pyrefly: ignore[unsupported-operation]
    extension = extend_rig(tmp_path, wrong, charuco_capture.board, Silent(), replaced=("cam2",))
    assert extension.fixed == ("cam1",)
    assert list(extension.rig.cameras) == ["cam0", "cam1", "cam2"]
    assert_near_truth(extension.rig, true, "cam2")
    assert extension.rig.cameras["cam2"].valid_radius_px is None  # a polynomial extrapolates a long lens well


@pytest.mark.thorough
def test_a_rational_lens_of_an_added_camera_is_limited_to_its_corners(charuco_capture):
    rig = part_of(charuco_capture.rig, "cam0", "cam1")
    board, folder = charuco_capture.board, charuco_capture.folder
    extension = extend_rig(folder, rig, board, Silent(), lens_model="rational")
    camera = extension.rig.cameras["cam2"]
    reach_px = camera.valid_radius_px
    assert reach_px is not None
    assert 0.3 * camera.size_px[0] < reach_px < find_corner_radius_px(camera)
    assert extension.rig.cameras["cam1"].valid_radius_px is None


@pytest.mark.parametrize(
    ("names", "replaced", "line"),
    [
        (("cam0", "cam1", "cam2"), (), "the rig has all its cameras (cam0, cam1, cam2)"),
        (("cam0", "cam1"), ("cam9",), "--replace cam9: the rig has the cameras cam0, cam1"),
        (("cam0", "cam1"), ("cam0",), "--replace cam0: it is the core camera"),
    ],
)
def test_what_cannot_be_added_is_refused(charuco_capture, names, replaced, line):
    rig = part_of(charuco_capture.rig, *names)
    with pytest.raises(InputError) as error:
        extend_rig(charuco_capture.folder, rig, charuco_capture.board, Silent(), replaced=replaced)
    assert line in str(error.value)


def test_a_camera_without_common_views_is_named(charuco_capture, tmp_path):
    frames = sorted((charuco_capture.folder / "cam0").iterdir())
    for name, chosen in (("cam0", frames[:4]), ("cam2", frames[4:])):
        (tmp_path / name).mkdir()
        for frame in chosen:
            shutil.copy(charuco_capture.folder / name / frame.name, tmp_path / name)
    rig = part_of(charuco_capture.rig, "cam0", "cam1")
    with pytest.raises(InputError, match="no frame is of two cameras"):
        extend_rig(tmp_path, rig, charuco_capture.board, Silent())
    dark = np.zeros(rig.core_camera.size_px[::-1], dtype=np.uint8)
    for frame in frames[:4]:
        write_image(tmp_path / "cam2" / frame.name, dark)
    with pytest.raises(
        CalibrationError, match="camera cam2: shares no view of the board with cam0, which keep"
    ):
        extend_rig(tmp_path, rig, charuco_capture.board, Silent())
