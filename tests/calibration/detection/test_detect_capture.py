"""Detection over a whole recording: a board that shows late, and the images that are looked at first."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from beltscape.calibration.detection import detect_capture
from beltscape.calibration.detection.detect_capture import detect_board, order_spread
from beltscape.calibration.detection.detector import PrintVariant
from beltscape.core.errors import InputError
from beltscape.core.progress import Silent
from beltscape.files.capture import read_capture
from beltscape.target.board import CharucoBoard
from tests.synthetic.boards import Print, camera, facing, view
from tests.thorough import list_cases

BOARD = CharucoBoard(squares=(6, 4), square_mm=44, marker_mm=31, dictionary="DICT_5X5_50")
FRAMES = 20


def write_recording(folder, board, how, cameras=8, seen_by=1):
    """Write a recording in which the board is shown in the last tenth of the frames, to some of the cameras."""
    lens = camera("a")
    shown = view(lens, facing(BOARD), BOARD, how)
    blank = np.full_like(shown, 120)
    for number in range(cameras):
        path = folder / f"cam{number:02d}"
        path.mkdir(parents=True)
        for frame in range(FRAMES):
            is_shown = frame >= 0.9 * FRAMES and number >= cameras - seen_by
            cv2.imwrite(str(path / f"{frame:03d}.png"), shown if is_shown else blank)
    return read_capture(folder, None)


PRINTS = [PrintVariant(False, True), PrintVariant(True, False), PrintVariant(True, True)]


@pytest.mark.parametrize("how", list_cases(PRINTS, PRINTS[-1:]))
def test_a_board_that_shows_late_is_found_in_any_print(tmp_path, how):
    capture = write_recording(tmp_path, BOARD, Print(how.legacy, how.inverted), seen_by=2)
    detections, variant = detect_board(capture, BOARD, Silent())
    assert variant == how
    assert {name: len(views) for name, views in detections.views.items() if views} == {"cam06": 2, "cam07": 2}


@pytest.mark.thorough
@pytest.mark.parametrize("how", PRINTS)
@pytest.mark.parametrize("seen_by", [1, 20])
def test_a_board_in_the_last_tenth_before_twenty_cameras_is_found(tmp_path, how, seen_by):
    capture = write_recording(tmp_path, BOARD, Print(how.legacy, how.inverted), 20, seen_by)
    detections, variant = detect_board(capture, BOARD, Silent())
    assert variant == how
    assert sum(len(views) for views in detections.views.values()) == 2 * seen_by


def test_a_print_that_is_not_the_stated_one_is_named_however_late_it_shows(tmp_path):
    stated = BOARD.model_copy(update={"legacy": False, "inverted": False})
    capture = write_recording(tmp_path, stated, Print(legacy=True, inverted=True), cameras=6)
    with pytest.raises(InputError, match=r"inverted = true.*correct board\.toml"):
        detect_board(capture, stated, Silent())


def test_variants_that_look_alike_do_not_take_the_whole_recording() -> None:
    board = CharucoBoard(squares=(6, 5), square_mm=44, marker_mm=31, dictionary="DICT_5X5_50")
    image = view(camera("a"), facing(board), board)
    read = []
    images = (read.append(None) or image for _ in range(100))
    # an odd number of rows: both layouts are one
    options = [PrintVariant(), PrintVariant(legacy=True)]
    assert detect_capture._select_variant(options, board, images) == PrintVariant()
    assert len(read) <= 24


@pytest.mark.parametrize("count", [1, 2, 7, 24, 100])
def test_any_first_part_is_spread_over_the_whole(count):
    order = order_spread(range(count))
    assert sorted(order) == list(range(count))
    for part in range(2, count):
        gaps = np.diff([-1, *sorted(order[:part]), count])
        assert gaps.max() <= 4 * count / part + 1
