"""Times of a capture's instants: the rules of encoder.csv hold for its first columns alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from beltscape.core.errors import InputError
from beltscape.files.times_csv import read_times


def write(tmp_path: Path, rows: str) -> Path:
    path = tmp_path / "times.csv"
    path.write_text(f"frame,timestamp_s\n{rows}", encoding="utf-8")
    return path


def test_frames_are_named_with_and_without_the_images_extension(tmp_path):
    assert read_times(write(tmp_path, "000,0.5\n001.png,0.75\n")) == {"000": 0.5, "001": 0.75}


@pytest.mark.parametrize(
    ("rows", "what"),
    [
        ("000,1\n001,1\n", "line 3: timestamp_s 1 is not after the row before"),
        ("000,1\n000.png,2\n", "line 3: frame 000 is there twice"),
        (",1\n", "line 2: no frame is named"),
        ("000,soon\n", "line 2: timestamp_s 'soon' is not a number"),
    ],
)
def test_what_cannot_be_is_refused_by_its_line(tmp_path, rows, what):
    with pytest.raises(InputError, match=what):
        read_times(write(tmp_path, rows))
