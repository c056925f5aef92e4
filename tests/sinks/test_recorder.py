"""The recorder of raw frames: modes, ring, kept recordings."""

from __future__ import annotations

import threading
import time

from beltscape.files.capture import read_capture
from beltscape.sinks.recorder import Recorder
from beltscape.sinks.recording import CaptureWriter
from tests.sinks.recordings import frames, holds, settings, settled


def test_mode_off_records_nothing(tmp_path):
    recorder = Recorder(tmp_path / "recordings", settings(mode="off"))
    recorder.take(frames(1))
    assert recorder.keep("alarm") is None
    recorder.close()
    assert list(tmp_path.iterdir()) == []


def test_all_is_recorded_in_captures_of_some_minutes(tmp_path, clock):
    recorder = Recorder(tmp_path, settings(mode="all", capture_min=1))
    for number in range(20):
        recorder.take(frames(number))
        settled(recorder)
        clock.now += 10
    assert recorder.keep("alarm") is None
    recorder.close()
    captures = sorted((tmp_path / "all").iterdir())
    assert [holds(c, range(6 * i, min(20, 6 * i + 6))) for i, c in enumerate(captures)] == [True] * 4
    assert recorder.state.written == 20 and recorder.state.dropped == 0


def test_the_ring_holds_the_last_minutes_and_keeps_them(tmp_path, clock):
    recorder = Recorder(tmp_path, settings(mode="ring", ring_min=2))
    for number in range(100):
        recorder.take(frames(number))
        settled(recorder)
        clock.now += 4
    kept = recorder.keep("overload: 812 t/h!")
    settled(recorder)
    assert kept is not None and kept.name.endswith("-overload-812-t-h")
    first = int(read_capture(kept).frames[0])
    # two minutes are thirty frame sets; the ring goes piece by piece, of three each
    assert 100 - 34 <= first <= 100 - 30
    assert holds(kept, range(first, 100))
    assert list((tmp_path / "ring").iterdir()) == []
    assert recorder.keep("again") is None
    for number in range(100, 105):
        recorder.take(frames(number))
    again = recorder.keep("again")
    recorder.close()
    assert again is not None and holds(again, range(100, 105))


def test_reversed_belt_begins_a_new_capture(tmp_path):
    recorder = Recorder(tmp_path, settings(mode="ring"))
    for number in (5, 6, 7, 1, 2):
        recorder.take(frames(number))
    kept = recorder.keep("")
    recorder.close()
    assert kept is not None and holds(kept, (1, 2))
    assert holds(kept.with_name(f"{kept.name}-before1"), (5, 6, 7))


def test_ring_of_an_ended_run_can_be_kept(tmp_path):
    recorder = Recorder(tmp_path, settings(mode="ring"))
    for number in range(5):
        recorder.take(frames(number))
    recorder.close()
    (piece,) = (tmp_path / "ring").iterdir()
    with (piece / "encoder.csv").open("a") as file:
        file.write("000005,1.0")  # a power cut
    recorder = Recorder(tmp_path, settings(mode="ring"))
    recorder.take(frames(0))
    kept = recorder.keep("restart")
    recorder.close()
    assert kept is not None and holds(kept, (0,))
    assert holds(kept.with_name(f"{kept.name}-before1"), range(5))


def test_a_slow_disk_never_blocks_and_is_counted(tmp_path, monkeypatch):
    gate = threading.Event()
    write = CaptureWriter.write

    def slow(self, its):
        gate.wait(10)
        return write(self, its)

    monkeypatch.setattr(CaptureWriter, "write", slow)
    recorder = Recorder(tmp_path, settings(mode="all", queue=4))
    start = time.perf_counter()
    for number in range(50):
        recorder.take(frames(number))
    assert time.perf_counter() - start < 1
    assert recorder.state.dropped == 46 and recorder.state.waiting == 4
    gate.set()
    recorder.close()
    assert recorder.state.written == 4
    (capture,) = (tmp_path / "all").iterdir()
    assert holds(capture, range(4))


def test_a_move_that_a_crash_interrupted_is_finished(tmp_path):
    recorder = Recorder(tmp_path, settings(mode="ring"))
    for number in range(3):
        recorder.take(frames(number))
    kept = recorder.keep("crash")
    recorder.close()
    assert kept is not None
    kept.rename(kept.with_name(f"{kept.name}.part"))
    Recorder(tmp_path, settings(mode="off")).close()
    assert holds(kept, range(3))
