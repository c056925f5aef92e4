"""Kalibr's target.yaml as a board."""

from __future__ import annotations

import pytest

from beltscape.core.errors import InputError
from beltscape.target.board import AprilGrid, Chessboard, read_board

APRILGRID = "target_type: 'aprilgrid'  # gridtype\ntagCols: 6\ntagRows: 5\ntagSize: 0.088\ntagSpacing: 0.3\n"
CHECKERBOARD = """target_type: 'checkerboard'
targetCols: 9
targetRows: 6
rowSpacingMeters: 0.035
colSpacingMeters: 0.035
"""


def read(folder, text):
    path = folder / "target.yaml"
    path.write_text(text)
    return read_board(path)


def test_both_kinds_are_read(tmp_path):
    assert read(tmp_path, APRILGRID) == AprilGrid(tags=(6, 5), tag_mm=88, spacing=0.3)
    assert read(tmp_path, CHECKERBOARD) == Chessboard(corners=(9, 6), square_mm=35)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (APRILGRID.replace("aprilgrid", "circlegrid"), "target_type = 'circlegrid': must be 'aprilgrid'"),
        ("- 1\n", "target_type = None: must be 'aprilgrid'"),
        (APRILGRID.replace("tagSize: 0.088\n", ""), "tagSize is missing"),
        (APRILGRID.replace("0.088", "8 cm"), "tagSize = '8 cm': must be a length in metres"),
        (
            APRILGRID.replace("0.088", "88"),
            "tagSize = 88: must be a length in metres; in millimetres? write 0.088",
        ),
        (
            APRILGRID.replace("0.088", "8.8"),
            "tagSize = 8.8: must be a length in metres; in millimetres? write 0.0088",
        ),
        (APRILGRID.replace("tagCols: 6", "tagCols: 600"), "tags"),
        (
            CHECKERBOARD.replace("colSpacingMeters: 0.035", "colSpacingMeters: 0.03"),
            "differ; only boards of squares",
        ),
    ],
)
def test_an_invalid_target_is_refused(tmp_path, text, line):
    with pytest.raises(InputError, match=r"target\.yaml") as error:
        read(tmp_path, text)
    assert line in str(error.value)
    assert "\n" not in str(error.value)
