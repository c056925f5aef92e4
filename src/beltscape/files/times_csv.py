"""Times of a capture's instants, times.csv: ``frame,timestamp_s``; written where no encoder gives positions."""

from __future__ import annotations

from pathlib import Path

from beltscape.files.csv_table import parse_csv
from beltscape.files.images import EXTENSIONS
from beltscape.files.paths import AnyPath, as_path, read_text

FILE = "times.csv"
HEADER = ("frame", "timestamp_s")


def read_times(path: AnyPath) -> dict[str, float]:
    """Return the time of each frame, s.

    Raises
    ------
    InputError
        When a time is no number or does not follow the one before.
    """
    path, times_s = as_path(path), dict[str, float]()
    for line in parse_csv(read_text(path), str(path), HEADER):
        name = Path(line.values[0])
        time_s = line.parse_number(1, "timestamp_s")
        if times_s and time_s <= max(times_s.values()):
            raise line.error(
                f"timestamp_s {line.values[1]} is not after the row before; sort the rows by time"
            )
        times_s[name.stem if name.suffix.lower() in EXTENSIONS else line.values[0]] = time_s
    return times_s
