"""Recording of shots and sequences from cameras in memory."""

from __future__ import annotations

import io
import os
import pty
import threading
import time

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.files.capture import read_capture
from beltscape.files.encoder_csv import read_encoder
from beltscape.files.images import read_image
from beltscape.pipeline.recording import feed as feed_module
from beltscape.pipeline.recording import shots as shots_module
from beltscape.pipeline.recording.feed import FrameFeed, record_sequence
from beltscape.pipeline.recording.shots import (
    CornerCounter,
    KeyTrigger,
    TimedTrigger,
    find_next_number,
    record_shots,
)
from beltscape.sinks.recording import CaptureWriter
from beltscape.target.board import CharucoBoard
from tests.pipeline.recording.cameras import MemoryCameras
from tests.synthetic.boards import Print, camera, facing, view

CAMERAS = ("cam0", "cam1")


def make_sets(count: int, *, lost: frozenset[int] = frozenset(), position: bool = True) -> list[FrameSet]:
    """Return frame sets whose images tell their number; cam1 has none in those that are ``lost``."""
    return [
        FrameSet(
            f"{k:08d}",
            {
                name: np.full((8, 8), 60 + k % 150, np.uint8)
                for name in CAMERAS
                if not (name == "cam1" and k in lost)
            },
            round(k * 1e7),
            2.5 * k if position else None,
        )
        for k in range(count)
    ]


def start(sets: list[FrameSet], period_s: float = 0.01) -> tuple[FrameFeed, threading.Event]:
    interrupted = threading.Event()
    return FrameFeed(MemoryCameras(sets, period_s), None, interrupted), interrupted


def test_shots_by_count_follow_those_that_are_there(tmp_path):
    feed, _ = start(make_sets(60))
    first = record_shots(feed, CAMERAS, TimedTrigger(0.0, 2), CaptureWriter(tmp_path, "png"), Silent())
    again = record_shots(feed, CAMERAS, TimedTrigger(0.05, 2), CaptureWriter(tmp_path, "png"), Silent())
    assert [shot.frame for shot in (*first, *again)] == ["000", "001", "002", "003"]
    capture = read_capture(tmp_path)
    assert capture.cameras == CAMERAS
    assert capture.frames == ("000", "001", "002", "003")
    assert find_next_number(tmp_path) == 4


def test_a_shot_is_of_the_time_after_its_trigger(tmp_path):
    feed, _ = start(make_sets(60))
    time.sleep(0.2)  # some ten frame sets wait by now
    record_shots(feed, CAMERAS, TimedTrigger(0.0, 1), CaptureWriter(tmp_path, "png"), Silent())
    assert read_image(tmp_path / "cam0" / "000.png")[0, 0] > 60 + 10


def test_keys_of_a_pipe(tmp_path):
    feed, _ = start(make_sets(200))
    shots = record_shots(
        feed, CAMERAS, KeyTrigger(io.StringIO("\n\nq\n\n")), CaptureWriter(tmp_path, "png"), Silent()
    )
    assert len(shots) == 2


def test_keys_of_a_terminal():
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, "r") as stream:
        trigger = KeyTrigger(stream)
        time.sleep(0.1)
        os.write(ours, b" q")
        until = time.monotonic() + 5
        due = False
        while not trigger.is_finished and time.monotonic() < until:
            due |= trigger.is_due()
        assert due
        assert trigger.is_finished
    os.close(ours)


def test_a_camera_that_is_lost_gives_no_shot(tmp_path):
    feed, _ = start(make_sets(60, lost=frozenset(range(60))))
    reporter = Silent()
    shots = record_shots(feed, CAMERAS, TimedTrigger(0.0, 1), CaptureWriter(tmp_path, "png"), reporter)
    assert shots == []
    assert reporter.warnings == ["no shot: cam1 gave no image; cam1: lost: check power, cable"]
    assert list(tmp_path.iterdir()) == []


def test_no_images_at_all_name_the_camera(tmp_path, monkeypatch):
    monkeypatch.setattr(shots_module, "_PATIENCE_S", 0.1)
    feed, _ = start([])
    with pytest.raises(InputError, match=r"no images for 0 s; cam1: lost: check power, cable"):
        record_shots(feed, CAMERAS, TimedTrigger(0.0, 1), CaptureWriter(tmp_path, "png"), Silent())


def test_a_sequence_has_every_frame_and_its_position(tmp_path):
    feed, _ = start(make_sets(12, lost=frozenset({3})))
    done = record_sequence(feed, CAMERAS, lambda n: n >= 10, CaptureWriter(tmp_path, "tiff"), Silent())
    assert (done.frames, done.incomplete, done.without_position, done.dropped) == (10, 1, 0, 0)
    readings = read_encoder(tmp_path / "encoder.csv")
    assert [one.frame for one in readings] == [f"{k:05d}" for k in range(10)]
    assert [one.belt_position_mm for one in readings] == [2.5 * k for k in range(10)]
    assert not (tmp_path / "cam1" / "00003.tiff").exists()
    assert read_image(tmp_path / "cam0" / "00009.tiff")[0, 0] == 69


def test_a_slow_disk_drops_frames_and_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(feed_module, "QUEUE", 2)

    class SlowWriter(CaptureWriter):
        def write(self, frames: FrameSet) -> int:
            time.sleep(0.05)
            return super().write(frames)

    feed, _ = start(make_sets(40), period_s=0.005)
    reporter = Silent()
    done = record_sequence(feed, CAMERAS, lambda n: n >= 5, SlowWriter(tmp_path, "png"), reporter)
    assert done.dropped > 0
    assert "the disk is too slow" in reporter.warnings[-1]


def test_a_sequence_without_an_encoder_and_an_interruption(tmp_path):
    feed, interrupted = start(make_sets(30, position=False))
    reporter = Silent()
    threading.Timer(0.15, interrupted.set).start()
    done = record_sequence(feed, CAMERAS, lambda _: False, CaptureWriter(tmp_path, "png"), reporter)
    assert 0 < done.frames < 30
    assert done.without_position == done.frames
    assert "have no belt position" in reporter.warnings[-1]


def test_a_capture_whose_clock_began_anew_is_not_continued(tmp_path):
    """After a restart of the machine monotonic times begin at 0: rows out of order would spoil the whole capture."""
    feed, _ = start(make_sets(200)[100:])
    record_shots(feed, CAMERAS, TimedTrigger(0.0, 2), CaptureWriter(tmp_path, "png"), Silent())
    before = (tmp_path / "encoder.csv").read_bytes()
    feed, _ = start(make_sets(60))
    with pytest.raises(InputError, match=r"encoder\.csv: ends at 1\.\d+ s .* started anew .* --out"):
        record_shots(feed, CAMERAS, TimedTrigger(0.0, 2), CaptureWriter(tmp_path, "png"), Silent())
    assert (tmp_path / "encoder.csv").read_bytes() == before
    assert find_next_number(tmp_path) == 2
    assert len(read_encoder(tmp_path / "encoder.csv")) == 2


@pytest.mark.parametrize(("legacy", "inverted"), [(True, False), (False, True)])
def test_shots_of_a_board_in_any_print_are_counted(legacy, inverted):
    board = CharucoBoard(squares=(6, 6), square_mm=30, marker_mm=22, dictionary="DICT_5X5_100")
    image = view(camera("cam0"), facing(board), board, Print(legacy, inverted))
    counter = CornerCounter(board)
    images = {"cam0": image, "cam1": np.ascontiguousarray(image[:, ::-1])}
    for _ in range(3):  # decided after some 60 corners
        assert counter.count(images) == {"cam0": 25, "cam1": 25}
