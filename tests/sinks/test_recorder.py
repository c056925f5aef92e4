"""The recorder of raw frames: modes, ring, kept recordings."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.frames import FrameSet
from beltscape.files.capture import read_capture
from beltscape.files.rasters.images import read_image
from beltscape.files.tables.encoder_csv import read_encoder
from beltscape.sinks import recorder as recorder_module
from beltscape.sinks.recorder import Recorder
from beltscape.sinks.recording.capture_writer import CaptureWriter
from beltscape.sinks.settings import RecordingSettings
from tests.sinks.namespaces import run_with_small_disk

CAMERAS = ("cam0", "cam1")


def settings(**values) -> RecordingSettings:
    return RecordingSettings(**{"free_gib": 0, "queue": 1000, **values})


def frames(number: int, *, position_mm: float | None = None) -> FrameSet:
    rng = np.random.default_rng(number)
    images = {name: rng.integers(0, 256, (40, 50), dtype=np.uint8) for name in CAMERAS}
    return FrameSet(
        f"{number:06d}", images, number * 200_000_000, number * 10.0 if position_mm is None else position_mm
    )


def settled(recorder: Recorder) -> None:
    """Wait until nothing is left to do."""
    for _ in range(500):
        if not recorder._queue:
            return
        time.sleep(0.01)
    raise AssertionError("the recorder does not come to rest")


def holds(folder, numbers) -> bool:
    """Whether the capture has exactly those frame sets, to the pixel, with their readings."""
    capture = read_capture(folder)
    return (
        capture.frames == tuple(f"{n:06d}" for n in numbers)
        and [(r.frame, r.belt_position_mm) for r in read_encoder(folder / "encoder.csv")]
        == [(f"{n:06d}", n * 10.0) for n in numbers]
        and all(
            np.array_equal(read_image(capture.files[name][f"{n:06d}"]), frames(n).images[name])
            for n in numbers
            for name in CAMERAS
        )
    )


@pytest.fixture
def clock(monkeypatch):
    """A monotonic clock that only moves when it is set."""

    class Clock:
        now = 1000.0

        def monotonic(self) -> float:
            return self.now

        def __getattr__(self, name: str):
            return getattr(time, name)

    one = Clock()
    monkeypatch.setattr(recorder_module, "time", one)
    return one


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


def test_full_disk_pauses_recording_until_space_is_free(tmp_path, clock, monkeypatch):
    left = [10 << 30]
    monkeypatch.setattr(
        recorder_module.shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(100 << 30, 0, left[0])
    )
    recorder = Recorder(tmp_path, settings(mode="all", free_gib=4))
    for number, free in ((1, 10), (2, 3), (3, 3), (4, 5)):
        left[0] = free << 30
        clock.now += 2
        recorder.take(frames(number))
        settled(recorder)
        assert bool(recorder.trouble) == (free == 3)
        if free == 3:
            assert "3.0 GiB are free, 4 must stay" in recorder.trouble
    recorder.close()
    assert (recorder.state.written, recorder.state.dropped) == (2, 2)
    frames_there = [f for c in sorted((tmp_path / "all").iterdir()) for f in read_capture(c).frames]
    assert frames_there == ["000001", "000004"]


def test_an_error_while_writing_pauses_too(tmp_path, clock, monkeypatch):
    write, full = CaptureWriter.write, [True]

    def failing(self, its):
        if full[0]:
            raise OSError(28, "No space left on device")
        return write(self, its)

    monkeypatch.setattr(CaptureWriter, "write", failing)
    recorder = Recorder(tmp_path, settings(mode="ring"))
    recorder.take(frames(1))
    settled(recorder)
    assert "No space left on device" in recorder.trouble
    full[0] = False
    clock.now += 2
    recorder.take(frames(2))
    settled(recorder)
    assert recorder.trouble == ""
    kept = recorder.keep("")
    recorder.close()
    assert kept is not None and holds(kept, (2,))


def test_full_disk_loses_nothing_that_was_acknowledged(tmp_path):
    seen = run_with_small_disk("tests.sinks.recording.small_disk", tmp_path / "disk")
    assert "No space left on device" in seen["trouble"]
    assert 5 < seen["paused_at"] < 100
    assert seen["goes_on_at"] < 10_000
    assert seen["frames"] == seen["expected"]
    assert sum(seen["counted"]) == seen["goes_on_at"]
    assert seen["whole"]
    assert seen["hidden"] == []


def test_oldest_captures_that_are_not_kept_are_removed_first(tmp_path, clock):
    recorder = Recorder(tmp_path, settings(mode="ring"))
    recorder.take(frames(0))
    kept = recorder.keep("precious")
    recorder.close()
    size = sum(p.stat().st_size for p in tmp_path.rglob("*") if p.is_file())
    recorder = Recorder(tmp_path, settings(mode="all", capture_min=0.01, limit_gib=4.5 * size / 2**30))
    for number in range(1, 20):
        clock.now += 2
        recorder.take(frames(number))
        settled(recorder)
    recorder.close()
    assert recorder.state.size_bytes <= 5.5 * size
    assert kept is not None and holds(kept, (0,))
    there = [f for c in sorted((tmp_path / "all").iterdir()) for f in read_capture(c).frames]
    assert there == [f"{n:06d}" for n in range(20 - len(there), 20)]
    assert 2 <= len(there) <= 4


def test_kept_captures_that_fill_the_limit_pause_recording(tmp_path, clock):
    recorder = Recorder(tmp_path, settings(mode="ring", limit_gib=1e-5))
    for number in range(5):
        recorder.take(frames(number))
    kept = recorder.keep("one")
    settled(recorder)
    clock.now += 2
    recorder.take(frames(5))
    settled(recorder)
    assert "no longer needed" in recorder.trouble
    assert kept is not None
    shutil.rmtree(kept)  # a person removes it
    clock.now += 2
    recorder.take(frames(6))
    settled(recorder)
    assert recorder.trouble == ""
    recorder.close()


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


def test_a_folder_that_cannot_be_entered_pauses_recording_only():
    with tempfile.TemporaryDirectory() as name:
        done = subprocess.run(
            [sys.executable, "-m", "tests.sinks.recording.forbidden_folder", name],
            cwd=Path(__file__).parents[2], capture_output=True, text=True, check=False, timeout=60,
        )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    out = json.loads(done.stdout)
    assert out["before"]["written"] > 0 and out["before"]["trouble"] == ""
    assert "Permission denied" in out["forbidden"]["trouble"] and "permissions" in out["forbidden"]["trouble"]
    assert out["after"]["trouble"] == ""
    assert out["after"]["written"] > out["before"]["written"]
    assert "Permission denied" in out["begun forbidden"]["trouble"]
    assert out["begun forbidden"]["written"] == 0
    assert out["begun after"]["trouble"] == "" and out["begun after"]["written"] > 0
    assert len(out["captures"]) == len(set(out["captures"]))  # no number is given twice


@pytest.mark.parametrize(
    "error", [PermissionError(13, "Permission denied"), RuntimeError("no idea"), KeyError("x")]
)
def test_no_error_ends_the_recorder(tmp_path, monkeypatch, error):
    monkeypatch.setattr("beltscape.core.supervision.RESTART_S", 0.01)
    recorder = Recorder(tmp_path, settings(mode="all"))

    def fail(*_):
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(recorder_module.CaptureWriter, "write", fail)
        for number in range(3):
            recorder.take(frames(number))
        settled(recorder)
        assert str(error.args[-1]) in recorder.state.trouble
        assert recorder.state.dropped == 3
    recorder._checked_s = float("-inf")
    recorder.take(frames(7))
    settled(recorder)
    assert recorder.state.written == 1
    assert recorder.trouble == ""
    recorder.close()
