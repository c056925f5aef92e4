"""The recorder on full disks, and its limits."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from beltscape.files.capture import read_capture
from beltscape.sinks import recorder as recorder_module
from beltscape.sinks.recorder import Recorder
from beltscape.sinks.recording import CaptureWriter
from tests.sinks.namespaces import run_with_small_disk
from tests.sinks.recordings import frames, holds, settings, settled


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
