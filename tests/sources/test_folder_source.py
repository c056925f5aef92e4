"""The folder source: order of frames, missing and unusable images."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.core.progress import Silent
from beltscape.files.capture import read_capture
from beltscape.files.images import write_image
from beltscape.sources import folder as folder_module
from beltscape.sources.folder import FolderSource, choose_image_size, scale_rig_to_images
from tests.files.exchange.test_other_programs import make_rig

SIZE = {"cam0": (30, 20), "cam1": (30, 20)}


@pytest.fixture
def folder(tmp_path):
    for name in SIZE:
        for frame in ("2", "10", "1"):
            write_image(tmp_path / name / f"{frame}.png", np.full((20, 30), 100, np.uint8))
    return tmp_path


def source(folder, sizes=SIZE) -> tuple[FolderSource, Silent]:
    reporter = Silent()
    return FolderSource(read_capture(folder), sizes, reporter), reporter


def test_frames_are_in_natural_order_with_all_cameras(folder):
    frames, reporter = source(folder)
    assert (len(frames), frames.frames, frames.cameras) == (3, ("1", "2", "10"), ("cam0", "cam1"))
    sets = list(frames)
    assert [s.frame for s in sets] == ["1", "2", "10"]
    assert all(set(s.images) == {"cam0", "cam1"} for s in sets)
    assert reporter.warnings == []
    assert len(list(frames)) == 3  # it can be gone through again


def test_cameras_outside_the_rig_are_not_read(folder):
    (folder / "cam9").mkdir()
    (folder / "cam9" / "99.png").write_text("not an image")
    frames, reporter = source(folder)
    assert [s.frame for s in frames] == ["1", "2", "10"]
    assert reporter.warnings == []


def test_a_camera_without_images_is_named(folder):
    frames, reporter = source(folder, {**SIZE, "cam2": (30, 20)})
    assert frames.cameras == ("cam0", "cam1")
    assert reporter.warnings == [f"{folder}/cam2: no images of camera cam2; going on without it"]


def test_a_missing_frame_is_named_and_the_others_of_its_instant_are_kept(folder):
    (folder / "cam1" / "2.png").unlink()
    frames, reporter = source(folder)
    assert [set(s.images) for s in frames] == [{"cam0", "cam1"}, {"cam0"}, {"cam0", "cam1"}]
    assert reporter.warnings == [f"{folder}/cam1: no image for frame 2; going on without"]


def test_unusable_image_is_named_and_skipped(folder):
    (folder / "cam0" / "1.png").write_bytes(b"")
    write_image(folder / "cam1" / "2.png", np.zeros((20, 31), np.uint8))
    frames, reporter = source(folder)
    assert [set(s.images) for s in frames] == [{"cam1"}, {"cam0"}, {"cam0", "cam1"}]
    assert reporter.warnings == [
        f"{folder}/cam0/1.png: the file is empty (0 bytes); copy the image again; going on without this image",
        f"{folder}/cam1/2.png: 31×20 px, but the rig's cam1 has 30×20; going on without this image",
    ]


def test_previewed_frames_are_read_once(folder, monkeypatch):
    read: list[str] = []
    monkeypatch.setattr(
        folder_module, "read_image", lambda path: read.append(path.stem) or np.zeros((20, 30), np.uint8)
    )
    frames, _ = source(folder)
    assert [s.frame for s in frames.preview_frames({"1", "10"})] == ["1", "10"]
    assert [s.frame for s in frames] == ["1", "2", "10"]
    assert sorted(read) == ["1", "1", "10", "10", "2", "2"]  # two cameras
    assert len(list(frames)) == 3  # a third time they are read again
    assert len(read) == 12


def test_previewed_images_are_kept_up_to_a_limit(folder, monkeypatch):
    monkeypatch.setattr(folder_module, "_KEPT_BYTES", 2 * 20 * 30)
    frames, _ = source(folder)
    list(frames.preview_frames(frames.frames))
    assert sum(image.nbytes for images in frames._kept.values() for image in images.values()) == 2 * 20 * 30


def test_a_rig_is_scaled_to_binned_images_and_says_so():
    reporter, rig = Silent(), make_rig("cam0", "cam1")
    scaled = scale_rig_to_images(rig, {"cam0": (640, 360), "cam1": (640, 360)}, "capture", reporter)
    assert {camera.size_px for camera in scaled.cameras.values()} == {(640, 360)}
    assert reporter.warnings == [
        "capture: images of 640×360 px, the rig's are 1280×720; the rig is scaled by 0.5"
    ]
    assert scale_rig_to_images(rig, {"cam0": (1280, 720)}, "capture", reporter) is rig


def test_each_camera_is_scaled_to_its_own_images():
    reporter = Silent()
    scaled = scale_rig_to_images(
        make_rig("cam0", "cam1"), {"cam0": (1280, 720), "cam1": (640, 360)}, "capture", reporter
    )
    assert [camera.size_px for camera in scaled.cameras.values()] == [(1280, 720), (640, 360)]
    assert reporter.warnings[0].startswith("capture: cam1: images of 640×360 px")


@pytest.mark.parametrize(
    ("size", "reason"),
    [((1200, 720), "they are cropped, or of another camera"), ((720, 1280), "turned by a quarter")],
)
def test_cropped_and_turned_images_of_the_core_camera_are_refused_and_of_others_left_out(size, reason):
    rig, reporter = make_rig("cam0", "cam1"), Silent()
    with pytest.raises(InputError, match=f"capture/cam0: images are {size[0]}×{size[1]} px.*{reason}"):
        scale_rig_to_images(rig, {"cam0": size}, "capture", reporter)
    assert scale_rig_to_images(rig, {"cam1": size}, "capture", reporter) is rig
    (line,) = reporter.warnings
    assert line.startswith(f"capture/cam1: images are {size[0]}×{size[1]} px")
    assert reason in line
    assert line.endswith("; going on without these images")


def test_single_images_of_another_size_do_not_scale_the_rig():
    assert choose_image_size([(50, 40), (30, 20)], (30, 20)) == (30, 20)
    assert choose_image_size([(50, 40), (60, 48), (60, 48)], (30, 20)) == (60, 48)
    assert choose_image_size([], (30, 20)) is None
