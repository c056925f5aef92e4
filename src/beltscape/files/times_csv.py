"""Times of a capture's instants, times.csv: ``frame,timestamp_s``; written where no encoder gives positions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from beltscape.files.csv_table import CsvRow, append_rows, parse_csv
from beltscape.files.images import EXTENSIONS
from beltscape.files.paths import AnyPath, as_path, read_text

FILE = "times.csv"
HEADER = ("frame", "timestamp_s")


def append_time(capture: Path, frame: str, time_ns: int) -> int:
    """Append the time of an instant to a capture's times.csv, which is begun if need be; return the bytes written."""
    return append_rows(capture / FILE, ",".join(HEADER), f"{frame},{format_seconds(time_ns)}\n".encode())


def format_seconds(time_ns: int) -> str:
    """Return a time as seconds with nine decimals."""
    sign = "-" if time_ns < 0 else ""
    return f"{sign}{abs(time_ns) // 10**9}.{abs(time_ns) % 10**9:09d}"


def read_times(path: AnyPath) -> dict[str, float]:
    """Return the time of each frame, s; frame names may have the image file's extension.

    Raises
    ------
    InputError
        When a time is no number or does not follow the one before, or a frame is not named or occurs twice.
    """
    path = as_path(path)
    return {frame: time_ns * 1e-9 for _, frame, time_ns in parse_instants(read_text(path), str(path), HEADER)}


def parse_instants(text: str, file: str, header: Sequence[str]) -> Iterator[tuple[CsvRow, str, int]]:
    """Yield row, frame and time, ns, of a CSV file whose first columns are `HEADER`; messages name the ``file``.

    Raises
    ------
    InputError
        When a time is no number or does not follow the one before, or a frame is not named or occurs twice.
    """
    lines: dict[str, int] = {}
    latest_ns: int | None = None
    for line in parse_csv(text, file, header):
        name = Path(line.values[0])
        frame = name.stem if name.suffix.lower() in EXTENSIONS else line.values[0]
        time_ns = round(line.parse_number(1, "timestamp_s") * 1e9)
        if not frame:
            raise line.error("no frame is named; name the image file")
        if frame in lines:
            raise line.error(
                f"frame {frame} is there twice (also in line {lines[frame]}); remove one of them"
            )
        if latest_ns is not None and time_ns <= latest_ns:
            raise line.error(
                f"timestamp_s {line.values[1]} is not after the row before; sort the rows by time"
            )
        lines[frame], latest_ns = line.number, time_ns
        yield line, frame, time_ns
