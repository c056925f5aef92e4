"""The simulated cameras: common trigger instants and images, without a network."""

from __future__ import annotations

import tomllib

import numpy as np
import PIL.Image
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.alarms.settings import CameraSkew
from beltscape.core.errors import InputError
from beltscape.files.images import write_image
from beltscape.sources.fake_genicam.__main__ import project_tables
from beltscape.sources.fake_genicam.camera import InstantCounter, pixel_format, read_album, write_album
from beltscape.sources.fake_genicam.simulated_cameras import SimulatedCameras, read_pictures
from beltscape.sources.genicam.settings import CamerasSettings

PERIOD_NS = 100_000_000


@given(
    late=st.lists(st.lists(st.integers(-30, 30), min_size=3, max_size=3), min_size=1, max_size=40),
    start_ns=st.integers(0, 2**61),
    present=st.lists(st.booleans(), min_size=3, max_size=3),
)
def test_processes_agree_on_the_instant(tmp_path_factory, late, start_ns, present):
    path = tmp_path_factory.mktemp("instants") / "instants"
    each = [InstantCounter(path, 0.1) for _ in late[0]]
    first = late[0][0] * 1_000_000
    each[0].number_at(start_ns + first)
    for k, offsets in enumerate(late):
        for one, offset, here in zip(each, offsets, present, strict=True):
            if here:
                # the grid may have begun late itself and follows slowly: what is within half a period of it counts
                assert one.number_at(start_ns + first + k * PERIOD_NS + offset * 1_000_000) == k
    for one in each:
        one.close()


def test_later_process_continues_the_count(tmp_path):
    early = InstantCounter(tmp_path / "instants", 0.1)
    assert [early.number_at(5 + k * PERIOD_NS) for k in range(4)] == [0, 1, 2, 3]
    late = InstantCounter(tmp_path / "instants", 0.1)
    assert late.number_at(5 + 40 * PERIOD_NS) == 40
    assert early.number_at(5 + 39 * PERIOD_NS) == 39  # held up
    assert early.number_at(5 + 41 * PERIOD_NS) == 41
    early.close()
    late.close()


@pytest.mark.parametrize(
    ("shape", "dtype", "name"), [((3, 4), "u1", "Mono8"), ((3, 4), "u2", "Mono16"), ((3, 4, 3), "u1", "RGB8")]
)
def test_album_reads_back(tmp_path, shape, dtype, name):
    images = [np.full(shape, k, dtype) for k in range(3)]
    write_album(tmp_path / "a.npy", images)
    np.testing.assert_array_equal(read_album(tmp_path / "a.npy"), images)
    assert pixel_format(images[0]) == name
    with pytest.raises(InputError, match="picture 1"):
        write_album(tmp_path / "b.npy", [images[0], images[0][:2]])


def test_a_capture_s_frames_that_all_cameras_have_with_the_belt_s_counts(tmp_path):
    for name, frames in {"cam0": "012", "cam1": "0123"}.items():
        for frame in frames:
            write_image(tmp_path / name / f"{frame}.png", np.full((4, 5), int(frame), np.uint8))
    pictures, counts, per_round = read_pictures(tmp_path, 0.5)
    assert {name: len(images) for name, images in pictures.items()} == {"cam0": 3, "cam1": 3}
    assert (counts, per_round) == ([], 0)
    rows = "\n".join(f"{k},{k / 10},{20 * k}" for k in range(4))
    (tmp_path / "encoder.csv").write_text(f"frame,timestamp_s,belt_position_mm\n{rows}\n")
    assert read_pictures(tmp_path, 0.5)[1:] == ([0, 40, 80], 120)
    (tmp_path / "encoder.csv").write_text("frame,timestamp_s,belt_position_mm\n0,0,0\n")
    with pytest.raises(InputError, match="no row for frame 1"):
        read_pictures(tmp_path, 0.5)


@pytest.mark.parametrize("frames_per_s", [2.0, 10.0, 60.0])
@pytest.mark.parametrize("mm_per_count", [None, 0.01])
def test_the_printed_tables_are_a_project_that_reads_the_encoder(tmp_path, frames_per_s, mm_per_count):
    images = [np.zeros((3, 4), np.uint8)] * 2
    bench = SimulatedCameras(tmp_path / "bench", {"cam0": images, "cam1": images}, frames_per_s)
    tables = tomllib.loads(project_tables(bench, frames_per_s, mm_per_count))
    cameras = CamerasSettings.model_validate(tables["cameras"])
    assert cameras.allowed_skew_ms == pytest.approx(300 / frames_per_s)
    assert CameraSkew.model_validate(tables["alarms"]["camera_skew"]).skew_ms == cameras.allowed_skew_ms
    assert tables.get("encoder", {}).get("kind") == (None if mm_per_count is None else "camera")
    assert (cameras.encoder is None) == (mm_per_count is None)


def save(path, levels, mode: str) -> None:
    """An image of a mode of Pillow's: P has a palette, L is grey, RGB colour."""
    path.parent.mkdir(parents=True, exist_ok=True)
    PIL.Image.fromarray(np.asarray(levels, np.uint8)).convert(mode).save(path)


def test_grey_pictures_with_a_palette_or_three_channels_are_grey(tmp_path):
    levels = np.random.default_rng(3).integers(0, 255, (9, 7))
    for frame, mode in (("0", "L"), ("1", "P"), ("2", "RGB")):
        save(tmp_path / "cam0" / f"{frame}.png", levels + int(frame), mode)
    pictures, _, _ = read_pictures(tmp_path, 1.0)
    for shift, picture in enumerate(pictures["cam0"]):
        np.testing.assert_array_equal(picture, (levels + shift).astype(np.uint8))


def test_a_picture_of_another_form_is_named(tmp_path):
    save(tmp_path / "cam0" / "0.png", np.zeros((9, 7)), "L")
    color = np.zeros((9, 7, 3), np.uint8)
    color[..., 0] = 200
    write_image(tmp_path / "cam0" / "1.png", color)
    with pytest.raises(
        InputError, match=r"cam0/1\.png: 7×9 px RGB 8 bit, but .*cam0/0\.png is 7×9 px grey 8 bit"
    ):
        read_pictures(tmp_path, 1.0)
    write_image(tmp_path / "cam0" / "1.png", np.zeros((9, 8), np.uint8))
    with pytest.raises(InputError, match=r"cam0/1\.png: 8×9 px grey"):
        read_pictures(tmp_path, 1.0)
