"""Calibration from images: boards rendered through a known rig, and recorded ones."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from beltscape.calibration.detection.detector import PrintVariant
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.files.exchange import import_rig
from beltscape.files.images import read_image, write_image
from beltscape.files.json_text import to_json
from beltscape.files.rig_json import rig_document
from beltscape.pipeline.calibrating.calibration import calibrate
from beltscape.pipeline.calibrating.calibration_files import make_calibration_document
from beltscape.pipeline.calibrating.check import check
from beltscape.pipeline.calibrating.intrinsics import calibrate_intrinsics
from beltscape.target.board import CharucoBoard, Chessboard
from tests.detection_store import detect_anew
from tests.synthetic.boards import Print, board_poses, capture, row_of_cameras

CHESSBOARD = Chessboard(corners=(8, 5), square_mm=40)


def assert_recovered(
    found: Rig, true: Rig, *, focal: float = 0.006, angle_deg: float = 0.35, mm: float = 4.0
):
    """Focal length within a share of it, the baselines' directions and lengths within degrees and mm."""
    for name, camera in found.cameras.items():
        np.testing.assert_allclose(camera.focal_px, true.cameras[name].focal_px, rtol=focal)
        np.testing.assert_allclose(camera.center_px, true.cameras[name].center_px, atol=4)
        expected = true.relative_pose(name, found.core)
        assert (expected.inverse() @ found.cam_from_core[name]).angle_deg < angle_deg
        assert np.linalg.norm(expected.center_mm - found.cam_from_core[name].center_mm) < mm


@pytest.mark.thorough
def test_two_cameras_on_a_chessboard(tmp_path):
    rig = row_of_cameras(["left", "right"])
    capture(tmp_path, rig, CHESSBOARD, board_poses(CHESSBOARD, 8))
    found = calibrate(tmp_path, CHESSBOARD, None, Silent())
    assert_recovered(found.rig, rig)
    assert found.held_out is not None
    assert found.held_out.rms_px < 0.1
    assert found.held_out.frames == 8


@pytest.mark.thorough
def test_a_camera_mounted_upside_down_numbers_the_chessboard_alike(tmp_path):
    rig = row_of_cameras(["left", "right"])
    turned = Pose.of([0, 0, np.pi], [0, 0, 0]) @ rig.cam_from_core["right"]
    rig = replace(rig, cam_from_core={**rig.cam_from_core, "right": turned})
    capture(tmp_path, rig, CHESSBOARD, board_poses(CHESSBOARD, 8))
    assert_recovered(calibrate(tmp_path, CHESSBOARD, "left", Silent()).rig, rig)


def test_three_cameras_on_a_charuco_board(charuco_capture):
    reporter = Silent()
    found = calibrate(charuco_capture.folder, charuco_capture.board, None, reporter)
    assert_recovered(found.rig, charuco_capture.rig)
    assert (found.rig.core, list(found.rig.cameras)) == ("cam1", ["cam1", "cam0", "cam2"])
    assert found.variant == PrintVariant(legacy=False, inverted=False)
    assert found.held_out is not None
    assert found.training.rms_px < found.held_out.rms_px < 0.12
    assert abs(found.held_out.square_bias_mm) < 0.05
    assert reporter.warnings == []
    assert found.rig.quality["held_out"] == found.held_out.document()


def test_the_given_core_camera_is_used(charuco_capture):
    found = calibrate(charuco_capture.folder, charuco_capture.board, "cam2", Silent())
    assert found.rig.core == "cam2"
    assert_recovered(found.rig, charuco_capture.rig)


@pytest.mark.parametrize(
    ("squares", "legacy", "inverted"),
    [
        pytest.param((8, 6), True, False, marks=pytest.mark.thorough),
        pytest.param((8, 6), False, True, marks=pytest.mark.thorough),
        ((8, 6), True, True),
        pytest.param((6, 5), False, True, marks=pytest.mark.thorough),
    ],
)
def test_the_print_variant_is_determined_from_the_images(tmp_path, squares, legacy, inverted):
    board = CharucoBoard(squares=squares, square_mm=44, marker_mm=31, dictionary="DICT_5X5_50")
    rig = row_of_cameras(["a", "b"])
    capture(tmp_path, rig, board, board_poses(board, 8), Print(legacy, inverted))
    found = calibrate(tmp_path, board, None, Silent())
    assert found.variant == PrintVariant(legacy, inverted)
    assert_recovered(found.rig, rig, focal=0.01, angle_deg=0.6, mm=6)
    assert make_calibration_document(found)["board"]["inverted"] is inverted


@pytest.mark.thorough
def test_deep_and_coloured_images_calibrate_alike(tmp_path, charuco_capture):
    own = charuco_capture
    for name, frames in (("cam0", np.uint16(257)), ("cam1", None)):
        for path in (own.folder / name).iterdir():
            image = read_image(path)
            if frames is not None:
                write_image(tmp_path / name / f"{path.stem}.tiff", image.astype(np.uint16) * frames)
            else:
                write_image(tmp_path / name / path.name, np.repeat(image[..., None], 3, axis=2))
    found = calibrate(tmp_path, own.board, "cam0", Silent())
    assert_recovered(found.rig, own.rig)


@pytest.mark.thorough
def test_a_camera_seen_only_together_with_an_auxiliary_is_reached_through_it(tmp_path, charuco):
    rig = row_of_cameras(["near", "middle", "far"])
    frames = [f"{i:02d}" for i in range(12)]
    seen_by = {"near": frames[:6], "middle": frames, "far": frames[6:]}
    capture(tmp_path, rig, charuco, board_poses(charuco, 12), seen_by=seen_by)
    reporter = Silent()
    found = calibrate(tmp_path, charuco, "near", reporter)
    assert found.hierarchy.network.paths["far"] == ("near", "middle", "far")
    assert make_calibration_document(found)["cameras"]["far"]["path_from_core"] == ("near", "middle", "far")
    assert_recovered(found.rig, rig, focal=0.012, angle_deg=0.6, mm=6)
    assert [line.split(":", 1)[1] for line in reporter.warnings] == [
        " no image for frame 00, 01, 02, 03 and 2 more; going on without",
        " no image for frame 06, 07, 08, 09 and 2 more; going on without",
    ]


def test_a_frame_in_which_the_board_moved_between_cameras_is_reported(tmp_path, charuco_capture):
    own = charuco_capture
    shutil.copytree(own.folder, tmp_path, dirs_exist_ok=True)
    late = Pose(own.poses["03"].rotation, own.poses["03"].translation_mm + np.array([9.0, 0.0, 0.0]))
    moved = replace(own, poses={**own.poses, "03": late})
    write_image(tmp_path / "cam2" / "03.png", moved.render("cam2", "03"))
    document = make_calibration_document(calibrate(tmp_path, own.board, None, Silent()))
    rejected = {tuple(pair["cameras"]): list(pair["rejected"]) for pair in document["pairs"]}
    assert rejected == {("cam0", "cam1"): [], ("cam0", "cam2"): ["03"], ("cam1", "cam2"): ["03"]}


def test_a_bent_view_is_rejected_and_reported(tmp_path, charuco_capture):
    """A board that is not flat in one view: the image is warped by a wave of four pixels."""
    own = charuco_capture
    shutil.copytree(own.folder, tmp_path, dirs_exist_ok=True)
    path = tmp_path / "cam0" / "02.png"
    image = read_image(path)
    rows, columns = image.shape
    u, v = np.meshgrid(np.arange(columns, dtype=np.float32), np.arange(rows, dtype=np.float32))
    write_image(path, cv2.remap(image, u, v + 4 * np.sin(u / 30, dtype=np.float32), cv2.INTER_LINEAR))
    found = calibrate(tmp_path, own.board, None, Silent())
    assert list(found.hierarchy.monocular["cam0"].rejected) == ["02"]
    assert_recovered(found.rig, own.rig)


def test_threads_do_not_change_a_byte(monkeypatch, tmp_path, charuco_capture):
    for name in ("cam0", "cam1"):
        (tmp_path / name).mkdir()
        for path in sorted((charuco_capture.folder / name).iterdir())[:5]:
            (tmp_path / name / path.name).symlink_to(path)
    before, results = cv2.getNumThreads(), set()
    for cores, threads in [(1, 1), (7, 4)]:
        monkeypatch.setattr(os, "cpu_count", lambda cores=cores: cores)
        cv2.setNumThreads(threads)
        try:
            with detect_anew():
                found = calibrate(tmp_path, charuco_capture.board, None, Silent())
        finally:
            cv2.setNumThreads(before)
        results.add(to_json(rig_document(found.rig)) + to_json(make_calibration_document(found)))
    assert len(results) == 1


def test_check_scores_a_rig_on_views_that_it_was_not_calibrated_with(tmp_path, charuco_capture):
    own = charuco_capture
    fresh = capture(tmp_path, own.rig, own.board, board_poses(own.board, 4, seed=77))
    rig = calibrate(own.folder, own.board, None, Silent()).rig
    reporter = Silent()
    found = check(fresh.folder, rig, own.board, reporter)
    true = check(fresh.folder, own.rig, own.board, reporter)
    assert (found.score.frames, found.score.views) == (4, 12)
    assert true.score.rms_px < found.score.rms_px < 0.15
    assert set(found.rig_errors.residuals) == set(own.rig.cameras)
    assert found.fit.is_sound
    assert found.scale == 1
    assert reporter.warnings == []


def thin_out(folder: Path, target: Path, every: int) -> None:
    """Copy one of ``every`` frames of a recorded capture."""
    for camera in folder.iterdir():
        if camera.is_dir():
            (target / camera.name).mkdir()
            for path in sorted(camera.iterdir())[::every]:
                (target / camera.name / path.name).symlink_to(path)


@pytest.mark.thorough
def test_recorded_chessboards_of_opencv(real_data):
    found = calibrate(real_data("opencv_stereo"), Chessboard(corners=(9, 6), square_mm=25), None, Silent())
    assert {name: len(views) for name, views in found.detections.views.items()} == {"left": 13, "right": 13}
    assert found.held_out is not None
    assert found.held_out.rms_px < 0.25
    assert found.fit.is_sound
    assert abs(found.held_out.square_bias_mm) < 0.03
    first, second = found.rig.cam_from_core.values()
    assert np.linalg.norm(second.center_mm - first.center_mm) == pytest.approx(83.2, abs=0.3)
    for name, focal in (("left", 534.8), ("right", 537.0)):
        np.testing.assert_allclose(found.rig.cameras[name].focal_px, focal, atol=3)


@pytest.mark.thorough
def test_recorded_charuco_boards_close_by(real_data, tmp_path):
    board = CharucoBoard(squares=(20, 20), square_mm=4, marker_mm=3.2, dictionary="DICT_4X4_1000")
    thin_out(real_data("pycamset_calibration_charuco"), tmp_path, 3)
    found = calibrate(tmp_path, board, None, Silent())
    assert sum(len(views) for views in found.detections.views.values()) >= 22  # of 24
    assert list(found.detections.views) == ["1", "2", "3"]
    assert found.variant == PrintVariant(legacy=False, inverted=False)
    assert found.held_out is not None
    assert (
        found.held_out.median_px < 0.3
    )  # 0.64 px and 0.022 mm where the print could not be stretched as a whole
    assert found.held_out.square_rms_mm < 0.006
    assert any("the board is stretched: its rows are 0.6" in line for line in found.warnings)
    assert not found.fit.is_sound
    assert found.warnings[: len(found.fit.findings)] == found.fit.findings
    # near and far boards alike: each camera fits by itself within 0.36 px, together within 3.6 px with the pose of
    # the frames before, within 0.35 px with one of their own
    assert "frames cal15, cal18, cal20 contradict the others in one and the same way" in found.fit.findings[0]
    assert "a camera was moved or its focus touched after frame cal12" in found.fit.findings[0]
    assert "common instant" not in found.fit.findings[0]


@pytest.mark.thorough
def test_recorded_webcams_without_a_common_trigger_are_warned_about(real_data, tmp_path):
    board = CharucoBoard(squares=(4, 5), square_mm=54, marker_mm=40.5, dictionary="DICT_4X4_1000")
    reporter = Silent()
    thin_out(real_data("caliscope_4cam"), tmp_path, 2)
    found = calibrate(tmp_path, board, None, reporter)
    assert found.variant == PrintVariant(legacy=False, inverted=True)
    seen = {name: len(views) for name, views in found.detections.views.items()}
    assert set(found.rig.cameras) == {"cam_0", "cam_1", "cam_2", "cam_3"}
    assert sum(seen.values()) >= 35  # of 48
    skewed = [line for line in reporter.warnings if "not triggered at the same instant" in line]
    assert len(skewed) == 1
    assert skewed[0].count("–") >= 3  # pairs, each with the size of its skew in px
    assert found.training.median_px < 2.5


@pytest.mark.thorough
def test_single_cameras_measure_one_board_and_find_the_lenses_of_other_recordings(real_data):
    """Of caliscope's cameras 0 and 2 the reference is from recordings of their own.

    By the drawn board their focal lengths are 0.5 % too long and 0.9 % too short, by the measured one 0.6 % and 0.2 %
    too short. The two cameras of OpenCV's pair measure the same board, each by itself.
    """
    folder = real_data("caliscope_4cam")
    board = CharucoBoard(squares=(4, 5), square_mm=54, marker_mm=40.5, dictionary="DICT_4X4_1000")
    found = calibrate_intrinsics(folder, board, Silent())
    reference, _ = import_rig(folder / "reference_camera_array.toml", Silent())
    for name, share in (("cam_0", 0.007), ("cam_2", 0.004)):
        assert found.board_off_drawing_mm[name].any()
        own, other = found.monocular[name].camera, reference.cameras[name]
        np.testing.assert_allclose(own.focal_px.mean(), other.focal_px.mean(), rtol=share)
        assert found.held_out_px[name] < 0.06
    pair = calibrate_intrinsics(
        real_data("opencv_stereo"), Chessboard(corners=(9, 6), square_mm=25), Silent()
    )
    left, right = (pair.board_off_drawing_mm[name] for name in ("left", "right"))
    np.testing.assert_allclose(left, right, rtol=0.1)
    assert max(pair.held_out_px.values()) < 0.12  # 0.16 by the drawn board
