"""Small captures as the recorder writes them, found and read in tests."""

from __future__ import annotations

import shutil
import tarfile
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.files.capture import read_capture
from beltscape.pipeline.measuring.instants import list_instants
from beltscape.reprocessing.recordings.discovery import find_recordings
from beltscape.reprocessing.recordings.recording import FrameReader, Recording, Unreadable
from beltscape.sinks.recording import CaptureWriter
from beltscape.sources.folder import FolderSource
from beltscape.sources.replay import FrameTime, ReplaySource

CAMERAS = {"cam0": (306, 256), "cam1": (306, 256), "cam2": (306, 256)}
NAME = "000123-20261122T101500Z"


def write_capture(
    folder: Path, seed: int = 0, frames: int = 5, cameras: Sequence[str] = tuple(CAMERAS)
) -> Path:
    """Write a capture with encoder.csv and exposures.csv whose images are noise; return its folder."""
    noise = np.random.default_rng(seed)
    writer = CaptureWriter(folder, "png")
    for k in range(frames):
        images = {name: noise.integers(0, 255, (256, 306), np.uint8) for name in cameras}
        exposures_us = dict.fromkeys(cameras, 250.0 + k)
        time_ns, position_mm = 10**9 + k * 250_000_000 + seed, 1000.5 + 61.25 * k
        writer.write(FrameSet(f"{k:06d}", images, time_ns, position_mm, exposures_us))
    return folder


def find(
    source: object, *, with_positions: bool = True, frames_per_s: float | None = None
) -> tuple[list[Recording], list[Unreadable], list[str]]:
    """Return the recordings of a source, what could not be read, and the warnings."""
    reporter = Silent()
    found = find_recordings(
        str(source),
        CAMERAS,
        "cam0",
        with_positions=with_positions,
        frames_per_s=frames_per_s,
        reporter=reporter,
    )
    return (*found, reporter.warnings)


def read(recording: Recording) -> tuple[list[FrameSet], list[str]]:
    """Return all frame sets of a recording, and the warnings."""
    reporter = Silent()
    return list(FrameReader(recording.place, CAMERAS, reporter).read(recording.frames)), reporter.warnings


def replay(
    folder: Path, *, with_positions: bool = True, frames_per_s: float | None = None
) -> tuple[list[FrameSet], list[str]]:
    """Return the frame sets of a replay of a capture folder, and its warnings, as `open_source` replays it."""
    reporter = Silent()
    source = FolderSource(read_capture(folder), CAMERAS, reporter)
    table = folder / "encoder.csv" if with_positions else None
    instants = list_instants(source, table, frames_per_s, reporter)
    times = [FrameTime(one.frame, one.time_ns or 0, one.position_mm) for one in instants]
    return list(ReplaySource(source, times, paced=False)), reporter.warnings


def assert_equal_frames(found: Sequence[FrameSet], wanted: Sequence[FrameSet]) -> None:
    """Compare frame sets: every image, time, position and exposure time."""
    assert [one.frame for one in found] == [one.frame for one in wanted]
    for one, other in zip(found, wanted, strict=True):
        assert (one.time_ns, one.position_mm) == (other.time_ns, other.position_mm)
        assert dict(one.exposures_us) == dict(other.exposures_us)
        assert list(one.images) == list(other.images)
        for name, image in one.images.items():
            assert image.dtype == other.images[name].dtype
            np.testing.assert_array_equal(image, other.images[name])


def pack(folder: Path, archive: Path, inner: str = "") -> Path:
    """Pack a folder as a zip or tar by the archive's name, below the folder ``inner`` in it; return the archive."""
    if archive.suffix == ".zip":
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
            for path in sorted(folder.rglob("*")):
                packed.write(path, Path(inner) / path.relative_to(folder))
        return archive
    with tarfile.open(archive, "w:gz" if archive.suffix in (".gz", ".tgz") else "w") as packed:
        packed.add(folder, inner or ".")
    return archive


def copy(folder: Path, target: Path) -> Path:
    """Return a copy of a capture that a test may damage."""
    return Path(shutil.copytree(folder, target))
