"""What the simulated cameras agree on, without any camera."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import InputError
from beltscape.files.images import write_image
from beltscape.sources.genicam.fake.album import pixel_format, read_album, write_album
from beltscape.sources.genicam.fake.capture import pictures_of
from beltscape.sources.genicam.fake.instants import Instants

PERIOD_NS = 100_000_000


@given(
    late=st.lists(st.lists(st.integers(-30, 30), min_size=3, max_size=3), min_size=1, max_size=40),
    start_ns=st.integers(0, 2**61),
    present=st.lists(st.booleans(), min_size=3, max_size=3),
)
def test_processes_agree_on_the_instant_whatever_they_missed(tmp_path_factory, late, start_ns, present):
    path = tmp_path_factory.mktemp("instants") / "instants"
    each = [Instants(path, 0.1) for _ in late[0]]
    first = late[0][0] * 1_000_000
    each[0].of(start_ns + first)
    for k, offsets in enumerate(late):
        for one, offset, here in zip(each, offsets, present, strict=True):
            if here:
                # the grid may have begun late itself and follows slowly: what is within half a period of it counts
                assert one.of(start_ns + first + k * PERIOD_NS + offset * 1_000_000) == k
    for one in each:
        one.close()


def test_one_that_comes_later_counts_on(tmp_path):
    early = Instants(tmp_path / "instants", 0.1)
    assert [early.of(5 + k * PERIOD_NS) for k in range(4)] == [0, 1, 2, 3]
    late = Instants(tmp_path / "instants", 0.1)
    assert late.of(5 + 40 * PERIOD_NS) == 40
    assert early.of(5 + 39 * PERIOD_NS) == 39  # held up
    assert early.of(5 + 41 * PERIOD_NS) == 41
    early.close()
    late.close()


@pytest.mark.parametrize(
    ("shape", "dtype", "name"), [((3, 4), "u1", "Mono8"), ((3, 4), "u2", "Mono16"), ((3, 4, 3), "u1", "RGB8")]
)
def test_an_album_reads_back(tmp_path, shape, dtype, name):
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
    pictures, counts, per_round = pictures_of(tmp_path, 0.5)
    assert {name: len(images) for name, images in pictures.items()} == {"cam0": 3, "cam1": 3}
    assert (counts, per_round) == ([], 0)
    rows = "\n".join(f"{k},{k / 10},{20 * k}" for k in range(4))
    (tmp_path / "encoder.csv").write_text(f"frame,timestamp_s,belt_position_mm\n{rows}\n")
    assert pictures_of(tmp_path, 0.5)[1:] == ([0, 40, 80], 120)
    (tmp_path / "encoder.csv").write_text("frame,timestamp_s,belt_position_mm\n0,0,0\n")
    with pytest.raises(InputError, match="no row for frame 1"):
        pictures_of(tmp_path, 0.5)
