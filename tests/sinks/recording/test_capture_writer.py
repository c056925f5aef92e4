"""Recorded captures: images, times and encoder readings read back exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from beltscape.core.frames import FrameSet
from beltscape.files.capture import read_capture
from beltscape.files.encoder_csv import read_encoder
from beltscape.files.images import read_image
from beltscape.files.times_csv import format_seconds
from beltscape.sinks.recording import CaptureWriter
from tests.thorough import examples

sizes = st.tuples(st.integers(1, 12), st.integers(1, 12))
images = st.one_of(
    *(
        sizes.flatmap(lambda size, kind=kind, rgb=rgb: arrays(kind, (*size, 3) if rgb else size))
        for kind in (np.uint8, np.uint16)
        for rgb in (False, True)
    )
)


def frames(number: int, **values) -> FrameSet:
    image = np.full((6, 8), number, np.uint8)
    whole = FrameSet(f"{number:06d}", {"cam0": image, "cam1": image + 1}, number * 200_000_000, number * 7.3)
    return replace(whole, **values)


@pytest.mark.parametrize("how", ["tiff", "png"])
@examples(30)
@given(image=images)
def test_images_read_back_exactly(tmp_path_factory, how, image):
    folder = tmp_path_factory.mktemp("capture")
    frame = FrameSet("7", {"cam0": image})
    CaptureWriter(folder, how).write(frame)
    back = read_image(folder / "cam0" / f"7.{how}")
    assert back.dtype == image.dtype
    assert np.array_equal(back, frame.images["cam0"])


@given(st.integers(-(10**18), 10**18))
def test_times_have_all_their_digits(time_ns):
    whole, part = format_seconds(time_ns).lstrip("-").split(".")
    assert (int(whole) * 10**9 + int(part)) * (-1 if time_ns < 0 else 1) == time_ns


def test_a_capture_of_the_contract(tmp_path):
    writer = CaptureWriter(tmp_path, "tiff")
    sizes = [writer.write(frames(n)) for n in range(5)]
    sizes.append(writer.write(frames(5, images={"cam1": np.zeros((6, 8), np.uint8)})))
    assert sum(sizes) == sum(p.stat().st_size for p in tmp_path.rglob("*") if p.is_file())
    capture = read_capture(tmp_path)
    assert capture.cameras == ("cam0", "cam1")
    assert capture.frames == tuple(f"{n:06d}" for n in range(6))
    assert "000005" not in capture.files["cam0"]
    readings = read_encoder(tmp_path / "encoder.csv")
    assert [(r.frame, r.time_ns, r.belt_position_mm) for r in readings] == [
        (f"{n:06d}", n * 200_000_000, n * 7.3) for n in range(6)
    ]


def test_instant_without_images_still_has_a_belt_position(tmp_path):
    writer = CaptureWriter(tmp_path, "tiff")
    writer.write(frames(1, images={}))
    writer.write(frames(2))
    assert [r.frame for r in read_encoder(tmp_path / "encoder.csv")] == ["000001", "000002"]
    assert read_capture(tmp_path).frames == ("000002",)


def test_capture_without_an_encoder_has_no_table(tmp_path):
    CaptureWriter(tmp_path, "tiff").write(frames(1, position_mm=None))
    assert not (tmp_path / "encoder.csv").exists()


@pytest.mark.parametrize(
    "next_one",
    [frames(3), frames(4, frame="000003"), frames(4, time_ns=600_000_000), frames(4, position_mm=21.8)],
)
def test_frame_set_that_a_reader_would_refuse_begins_a_new_capture(tmp_path, next_one):
    writer = CaptureWriter(tmp_path, "tiff")
    writer.write(frames(3))
    assert writer.can_append(frames(4))
    assert writer.can_append(frames(4, time_ns=None, position_mm=None))
    assert not writer.can_append(next_one)


def test_frame_set_that_cannot_be_written_leaves_nothing(tmp_path, monkeypatch):
    import pathlib

    writer = CaptureWriter(tmp_path, "tiff")
    writer.write(frames(1))
    before = sorted(p for p in tmp_path.rglob("*"))
    write_bytes = pathlib.Path.write_bytes

    def full(path, data):
        if "cam1" in str(path):
            write_bytes(path, data[:20])
            raise OSError(28, "No space left on device")
        return write_bytes(path, data)

    monkeypatch.setattr(pathlib.Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space"):
        writer.write(frames(2))
    assert sorted(p for p in tmp_path.rglob("*")) == before
