"""Captures from videos: the choice of frames, and a calibration from them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.core.progress import Silent
from beltscape.files.images import read_image
from beltscape.pipeline.calibrating.views import extract_frames, select_frames
from tests.synthetic.demo import parse_json

REPEATS = 5
SHARP = 2
"""Number of the sharp frame among the repeats of a view."""
BOARD = 'kind = "charuco"\nsquares = [8, 6]\nsquare_mm = 40\nmarker_mm = 29\ndictionary = "DICT_4X4_50"\n'


def write_video(path, images):
    height, width = images[0].shape
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30, (width, height))
    assert writer.isOpened()
    for image in images:
        writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    writer.release()


@pytest.fixture(scope="module")
def videos(tmp_path_factory, charuco_capture):
    """One video per camera: every view five times, four of them blurred."""
    folder = tmp_path_factory.mktemp("videos")
    for name in charuco_capture.rig.cameras:
        views = [read_image(path) for path in sorted((charuco_capture.folder / name).iterdir())]
        images = [
            view if repeat == SHARP else cv2.GaussianBlur(view, (0, 0), 2.5)
            for view in views
            for repeat in range(REPEATS)
        ]
        write_video(folder / f"{name}.avi", images)
    return folder


def test_the_sharp_frame_of_each_view_is_chosen_in_every_camera(videos, tmp_path):
    capture = extract_frames(videos, tmp_path / "frames", Silent(), synchronous=True)
    numbers = [int(frame) for frame in capture.frames]
    assert numbers == [SHARP + REPEATS * view for view in range(8)]
    assert all(tuple(files) == capture.frames for files in capture.files.values())


@pytest.mark.thorough
def test_lenses_are_calibrated_from_videos(videos, run, tmp_path):
    (tmp_path / "board.toml").write_text(BOARD)
    words = "--board", tmp_path / "board.toml", "--out", tmp_path / "rig", "--json"
    code, out, _ = run("calibrate", "intrinsics", videos, *words)
    assert code == 0
    for camera in parse_json(out)["cameras"].values():
        assert camera["quality"]["views"] >= 6  # poses that one camera sees nearly alike are chosen once
        assert camera["quality"]["rms_px"] < 0.2


def test_videos_of_unequal_length_are_refused(videos, charuco_capture, tmp_path):
    for name in ("cam0", "cam1"):
        (tmp_path / f"{name}.avi").write_bytes((videos / f"{name}.avi").read_bytes())
    view = read_image(next(iter((charuco_capture.folder / "cam2").iterdir())))
    write_video(tmp_path / "cam2.avi", [view] * 3)
    with pytest.raises(
        InputError, match=r"different numbers of frames \(cam0.avi 40, cam1.avi 40, cam2.avi 3\)"
    ):
        extract_frames(tmp_path, tmp_path / "frames", Silent(), synchronous=True)
    assert not (tmp_path / "frames").exists()


def test_a_file_that_is_no_video_is_refused(tmp_path):
    (tmp_path / "cam0.mp4").write_bytes(b"not a video")
    with pytest.raises(InputError, match=r"cam0.mp4: no frame of this video can be decoded"):
        extract_frames(tmp_path, tmp_path / "frames", Silent(), synchronous=True)


def test_a_board_at_rest_is_chosen_once():
    rng = np.random.default_rng(2)
    places = rng.uniform(0, 255, (4, 50))
    thumbnails = np.repeat(places, 25, axis=0) + rng.normal(0, 0.5, (100, 50))
    chosen = select_frames([(np.ones(100), thumbnails)])
    assert [number // 25 for number in chosen] == [0, 1, 2, 3]
