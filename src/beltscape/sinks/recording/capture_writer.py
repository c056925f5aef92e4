"""Writing of one capture, frame set by frame set."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from beltscape.core.frames import FrameSet, Image
from beltscape.files.tables.csv_table import append_rows
from beltscape.files.tables.encoder_csv import HEADER, read_encoder
from beltscape.files.tables.exposures_csv import FILE as EXPOSURES
from beltscape.files.tables.exposures_csv import HEADER as EXPOSURES_HEADER
from beltscape.files.tables.exposures_csv import format_exposures

ENCODER = "encoder.csv"
ENCODER_HEADER = ",".join(HEADER)
_HOW = {
    "tiff": [cv2.IMWRITE_TIFF_COMPRESSION, 1],  # none
    "png": [],  # OpenCV's default, run lengths: three times as fast as level 1, and no larger
}


class CaptureWriter:
    """Writes ``<folder>/<camera>/<frame>.<ext>``, ``encoder.csv`` and ``exposures.csv``; complete files only."""

    def __init__(self, folder: Path, image: str) -> None:
        """``image`` is "tiff" or "png"; the folder is created with the first frame set."""
        self.folder = folder
        self._image = image
        self._time_ns: int | None = None
        self._position_mm: float | None = None
        self._frames: set[str] = set()

    @property
    def frames(self) -> int:
        """Number of frame sets written."""
        return len(self._frames)

    def resume(self) -> None:
        """Continue a capture that is there: its last time and position are those that the next frame set must follow.

        Raises
        ------
        InputError
            When its encoder.csv is not valid.
        """
        truncate_partial_line(self.folder / EXPOSURES)
        path = self.folder / ENCODER
        if path.exists():
            truncate_partial_line(path)
            for last in read_encoder(path)[-1:]:
                self._time_ns, self._position_mm = last.time_ns, last.belt_position_mm

    def describe_break(self, frames: FrameSet) -> str:
        """Return how a frame set that cannot be appended breaks the order of this capture."""
        before, after = (format_seconds(time_ns or 0) for time_ns in (self._time_ns, frames.time_ns))
        return (
            f"{self.folder / ENCODER}: ends at {before} s and {self._position_mm} mm, the next frame set is of "
            f"{after} s and {frames.position_mm} mm"
        )

    def can_append(self, frames: FrameSet) -> bool:
        """Return whether a frame set fits into this capture: a new name, increasing time, no reversed belt."""
        return (
            frames.frame not in self._frames
            and (self._time_ns is None or frames.time_ns is None or frames.time_ns > self._time_ns)
            and (
                self._position_mm is None
                or frames.position_mm is None
                or frames.position_mm >= self._position_mm
            )
        )

    def write(self, frames: FrameSet) -> int:
        """Write one frame set; return the bytes written. After an OSError nothing of it is left."""
        written: list[Path] = []
        try:
            size = 0
            for camera, image in frames.images.items():
                path = self.folder / camera / f"{frames.frame}.{self._image}"
                written.append(path)
                size += _write(path, encode(image, self._image))
            size += self._write_exposures(frames) + self._write_reading(frames)
        except OSError:
            for path in written:
                path.unlink(missing_ok=True)
            raise
        self._frames.add(frames.frame)
        self._time_ns = frames.time_ns if frames.time_ns is not None else self._time_ns
        self._position_mm = frames.position_mm if frames.position_mm is not None else self._position_mm
        return size

    def _write_reading(self, frames: FrameSet) -> int:
        """Write the row of encoder.csv if time and position are known, also for an instant without an image."""
        if frames.time_ns is None or frames.position_mm is None:
            return 0
        self.folder.mkdir(parents=True, exist_ok=True)
        line = f"{frames.frame},{format_seconds(frames.time_ns)},{float(frames.position_mm)!r}\n"
        return append_rows(self.folder / ENCODER, ENCODER_HEADER, line.encode())

    def _write_exposures(self, frames: FrameSet) -> int:
        """Write the rows of exposures.csv where the exposure times are known."""
        rows = format_exposures(frames)
        return append_rows(self.folder / EXPOSURES, ",".join(EXPOSURES_HEADER), rows.encode()) if rows else 0


def truncate_partial_line(path: Path) -> None:
    """Remove an incomplete last row of a table, such as after a power failure."""
    data = path.read_bytes() if path.exists() else b""
    whole = data[: data.rfind(b"\n") + 1]
    if whole != data:
        path.write_bytes(whole)


def format_seconds(time_ns: int) -> str:
    """Return a time as seconds with nine decimals."""
    sign = "-" if time_ns < 0 else ""
    return f"{sign}{abs(time_ns) // 10**9}.{abs(time_ns) % 10**9:09d}"


def encode(image: Image, how: str) -> bytes:
    """Encode an image as TIFF without compression or as PNG; both are lossless."""
    bgr = image if image.ndim == 2 else np.ascontiguousarray(image[..., ::-1])
    return cv2.imencode(f".{how}", bgr, _HOW[how])[1].tobytes()


def _write(path: Path, data: bytes) -> int:
    """Write a file under a hidden name first, so that a crash leaves no incomplete image; return its size."""
    temporary = path.with_name(f".{path.name}.part")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        temporary.write_bytes(data)
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
    return len(data)
