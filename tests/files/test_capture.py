"""Capture folders: order of frames, cameras, and duplicates."""

from __future__ import annotations

import os
import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import InputError
from beltscape.files.capture import list_capture, read_capture
from beltscape.files.frame_names import natural_key
from beltscape.files.images import KINDS


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


def warn_of(folder) -> list[str]:
    return list_capture(folder).describe_omissions()


def test_whatever_is_left_out_is_named_with_its_folder_and_ending(tmp_path):
    make(
        tmp_path, "cam0/0.png", "cam0/notes.txt", "cam0/0.dng", "cam0/1.dng", "cam0/raw/2.png", "cam1/0.raw",
        "cam1/1.raw", "cam2/0.png", "lone.png", "cam3.mp4", "encoder.csv", "board.toml", "truth/belt.json",
    )  # fmt: skip
    (tmp_path / "cam4").mkdir()
    assert warn_of(tmp_path) == [
        f"{tmp_path}/cam0: 2 files .dng (0.dng, 1.dng); 1 file .txt (notes.txt); folder raw cannot be read; "
        f"images are {KINDS}",
        f"{tmp_path}/cam1: 2 files .raw (0.raw, 1.raw) cannot be read, and there is no other: going on without this "
        f"folder; images are {KINDS}",
        f"{tmp_path}/cam4: is empty; going on without it",
        f"{tmp_path}: cam3.mp4, lone.png beside the cameras' folders: left out, a capture is "
        "<capture>/<camera>/<frame>.png",
    ]


def test_what_systems_and_programs_leave_in_folders_is_not_named(tmp_path):
    make(
        tmp_path, "cam0/0.png", "cam0/.DS_Store", "cam0/Thumbs.db", "cam0/1.png.tmp", "cam0/._0.png", ".hidden/0.png",
        "@eaDir/0.png", "cam1/0.pgm", "cam1/1.webp", "cam1/2.jp2", "cam0/1.PPM", "cam0/2.pnm", ".DS_Store",
    )  # fmt: skip
    assert warn_of(tmp_path) == []
    assert read_capture(tmp_path).cameras == ("cam0", "cam1")


def test_pipes_sockets_and_links_to_nothing_are_named_not_opened(tmp_path):
    make(tmp_path, "cam0/0.png")
    os.mkfifo(tmp_path / "cam0" / "1.png")
    (tmp_path / "cam0" / "2.png").symlink_to(tmp_path / "nowhere.png")
    with socket.socket(socket.AF_UNIX) as own:
        own.bind(str(tmp_path / "cam0" / "3.png"))
        (line,) = warn_of(tmp_path)
    assert line.startswith(
        f"{tmp_path}/cam0: pipes, sockets, devices or links to nothing: 1.png, 2.png, 3.png cannot be read"
    )


def name(camera: str, pattern: str, numbers) -> list[str]:
    return [f"{camera}/{pattern.format(number)}.png" for number in numbers]


@pytest.mark.parametrize(
    ("patterns", "frames"),
    [
        (("cam0_{:03d}", "cam1_{:03d}"), ("000", "001", "002")),
        (("{:d}", "{:03d}"), ("000", "001", "002")),
        (("img-{:d}", "img-{:02d}"), ("img-00", "img-01", "img-02")),
        (("Basler_21234567_{:04d}", "Basler_998877_{:04d}"), ("0000", "0001", "0002")),
    ],
)
def test_frames_are_matched_by_their_number(tmp_path, patterns, frames):
    for k, pattern in enumerate(patterns):
        make(tmp_path, *name(f"cam{k}", pattern, range(3)))
    capture = read_capture(tmp_path)
    assert capture.frames == frames
    for k, pattern in enumerate(patterns):
        assert [path.stem for path in capture.files[f"cam{k}"].values()] == [
            pattern.format(i) for i in range(3)
        ]
    (line,) = capture.describe_omissions()
    assert line.startswith(
        f"{tmp_path}: frames are matched by their numbers (cam0 has {patterns[0].format(0)} …"
    )


def test_a_lost_frame_of_matched_cameras_is_named_by_the_common_name(tmp_path):
    make(tmp_path, *name("cam0", "{:d}", range(5)), *name("cam1", "{:03d}", (0, 1, 3, 4)))
    assert (
        read_capture(tmp_path).describe_omissions()[-1]
        == f"{tmp_path}/cam1: no image for frame 002; going on without"
    )


def test_equal_names_are_never_renamed(tmp_path):
    make(
        tmp_path, *name("cam0", "shot{:d}", range(3)), *name("cam1", "shot{:d}", range(1, 4)), "cam1/dark.png"
    )
    assert read_capture(tmp_path).frames == ("dark", "shot0", "shot1", "shot2", "shot3")


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (name("cam0", "cam0_{:03d}", range(3)), name("cam1", "cam1_{:03d}", range(1, 4))),
        (name("cam0", "{:d}", range(3)), name("cam1", "{:03d}", range(1, 4))),
        (name("cam0", "a{:d}", range(3)), ["cam1/b1.png", "cam1/b01.png", "cam1/b2.png"]),
        (["cam0/left.png"], ["cam1/right.png"]),
        (name("cam0", "{:d}", range(3)), name("cam1", "{:d}", range(7, 9))),
    ],
    ids=["an offset", "an offset of padded numbers", "a number twice", "no numbers", "other instants"],
)
def test_an_unclear_match_is_refused_with_the_names(tmp_path, one, other):
    make(tmp_path, *one, *other)
    with pytest.raises(InputError, match=r"cam0 has .*; cam1 has .*same name in every camera's folder"):
        read_capture(tmp_path)


def test_a_camera_of_other_names_is_named_and_the_others_are_kept(tmp_path):
    make(
        tmp_path, *name("cam0", "{:d}", range(3)), *name("cam1", "{:d}", range(3)), "cam2/a.png", "cam2/b.png"
    )
    line = read_capture(tmp_path).omissions["cam2"][0]
    assert line.startswith(
        f"{tmp_path}/cam2: none of its frames (a, b) is named as one of another camera (cam0 has 0 …"
    )
    assert read_capture(tmp_path, ("cam0", "cam1")).omissions == {}
