"""Exposure times are recorded with the images, so that a replay judges them as the running system did."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beltscape.core.errors import InputError
from beltscape.core.progress import Silent
from beltscape.files.capture import read_capture
from beltscape.files.exposures_csv import FILE
from beltscape.sinks.recording import CaptureWriter
from beltscape.sources.folder import FolderSource
from beltscape.sources.replay import FrameTime, ReplaySource
from tests.sinks.recordings import CAMERAS, frames


def replay(folder: Path, count: int) -> list[dict[str, float]]:
    source = FolderSource(read_capture(folder), dict.fromkeys(CAMERAS, (50, 40)), Silent())
    times = [FrameTime(f"{number:06d}", number * 200_000_000, None) for number in range(count)]
    return [dict(one.exposures_us) for one in ReplaySource(source, times, paced=False)]


def test_a_replay_has_the_exposure_times_of_the_recording(tmp_path: Path) -> None:
    stated = [{"cam0": 1500.0, "cam1": 1800.5}, {"cam0": 1200.25, "cam1": float("nan")}, {}]
    writer = CaptureWriter(tmp_path / "made", "png")
    for number, exposures_us in enumerate(stated):
        writer.write(replace(frames(number), exposures_us=exposures_us))
    np.testing.assert_equal(replay(tmp_path / "made", 3), stated)


def test_a_recording_without_exposure_times_has_no_file(tmp_path: Path) -> None:
    CaptureWriter(tmp_path / "made", "png").write(frames(0))
    assert not (tmp_path / "made" / FILE).exists()
    assert replay(tmp_path / "made", 1) == [{}]


def test_a_partial_row_is_removed_and_a_wrong_value_named(tmp_path: Path) -> None:
    folder = tmp_path / "made"
    first = CaptureWriter(folder, "png")
    first.write(replace(frames(0), exposures_us={"cam0": 1500.0, "cam1": 1500.0}))
    path = folder / FILE
    whole = path.read_text()
    path.write_text(whole + "000001,ca")
    CaptureWriter(folder, "png").resume()
    assert path.read_text() == whole
    path.write_text(whole.replace("1500.0", "-1", 1))
    with pytest.raises(InputError, match=r"exposures.csv: line 2: exposure_us -1 is not positive"):
        replay(folder, 1)
