"""Capture folders: order of frames, cameras, and duplicates."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import InputError
from beltscape.files.capture import read_capture
from beltscape.files.frame_names import natural_key


def make(folder, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()


def test_numbers_are_ordered_as_numbers(tmp_path):
    make(tmp_path, *(f"cam{c}/cal{i}.png" for c in (10, 2, 1) for i in (10, 9, 100, 1)))
    capture = read_capture(tmp_path)
    assert capture.cameras == ("cam1", "cam2", "cam10")
    assert capture.frames == ("cal1", "cal9", "cal10", "cal100")
    assert list(capture.files["cam1"]) == list(capture.frames)


@given(st.lists(st.text(alphabet="a0129_", max_size=6), unique=True))
def test_natural_order_is_total_and_does_not_depend_on_the_start(names):
    backwards = names[::-1]
    assert sorted(names, key=natural_key) == sorted(backwards, key=natural_key)
    assert len({natural_key(name) for name in names}) == len(names)


@given(st.integers(0, 10**12), st.integers(0, 10**12))
def test_natural_order_follows_the_numbers(a, b):
    assert (natural_key(f"f{a}") < natural_key(f"f{b}")) == (a < b)


def test_only_images_in_camera_folders_count(tmp_path):
    make(
        tmp_path, "encoder.csv", "lone.png", "cam0/0.png", "cam0/.hidden.png", "cam0/notes.txt", "cam1/0.TIF",
        "cam2/a.jpeg", "cam2/b.bmp", "empty/readme.md",
    )  # fmt: skip
    capture = read_capture(tmp_path)
    assert {camera: list(files) for camera, files in capture.files.items()} == {
        "cam0": ["0"], "cam1": ["0"], "cam2": ["a", "b"],
    }  # fmt: skip


def test_duplicate_frame_is_refused(tmp_path):
    make(tmp_path, "cam0/07.png", "cam0/07.tiff")
    with pytest.raises(InputError) as error:
        read_capture(tmp_path)
    assert str(error.value) == (
        f"{tmp_path}/cam0/07.tiff: frame 07 is there twice (also 07.png); remove one of them"
    )


def test_missing_frames_are_listed_for_each_camera(tmp_path):
    make(tmp_path, *(f"cam0/{i}.png" for i in range(8)), "cam1/0.png", "cam1/9.png", "cam2/0.png")
    assert read_capture(tmp_path).describe_omissions() == [
        f"{tmp_path}/cam0: no image for frame 9; going on without",
        f"{tmp_path}/cam1: no image for frame 1, 2, 3, 4 and 3 more; going on without",
        f"{tmp_path}/cam2: no image for frame 1, 2, 3, 4 and 4 more; going on without",
    ]


def test_a_full_capture_has_no_gaps(tmp_path):
    make(tmp_path, "cam0/0.png", "cam1/0.jpg")
    assert read_capture(tmp_path).describe_omissions() == []


def test_only_keeps_known_cameras_in_the_given_order(tmp_path):
    make(tmp_path, "a/0.png", "b/0.png", "c/1.png")
    capture = read_capture(tmp_path).select_cameras(("c", "nowhere", "a"))
    assert capture.cameras == ("c", "a")
    assert capture.frames == ("0", "1")


def test_missing_or_empty_folder_is_refused_with_the_layout(tmp_path):
    with pytest.raises(InputError) as missing:
        read_capture(tmp_path / "nowhere")
    with pytest.raises(InputError) as empty:
        read_capture(tmp_path)
    assert str(missing.value) == (
        f"{tmp_path}/nowhere: no such folder; a capture is <capture>/<camera>/<frame>.png"
    )
    assert str(empty.value) == (
        f"{tmp_path}: no camera folder with images in it; a capture is <capture>/<camera>/<frame>.png"
    )


def test_a_camera_folder_given_as_the_capture_is_refused(tmp_path):
    make(tmp_path, "cam0/0.png")
    with pytest.raises(InputError, match=r"no camera folder with images in it"):
        read_capture(tmp_path / "cam0")
