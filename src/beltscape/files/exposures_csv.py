"""Exposure times of a capture's images, exposures.csv: ``frame,camera,exposure_us``; no value while it changes."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from pathlib import Path

from beltscape.core.frames import FrameSet
from beltscape.files.csv_table import parse_csv
from beltscape.files.images import EXTENSIONS
from beltscape.files.paths import AnyPath, as_path, read_text

FILE = "exposures.csv"
HEADER = ("frame", "camera", "exposure_us")


def format_exposures(frames: FrameSet) -> str:
    """Return the rows of a frame set's images; empty where the exposure times are not known."""
    known = {name: us for name, us in frames.exposures_us.items() if name in frames.images}
    return "".join(f"{frames.frame},{name},{us if isfinite(us) else ''}\n" for name, us in known.items())


def read_exposures(path: AnyPath) -> Mapping[str, Mapping[str, float]]:
    """Return by frame and camera the exposure times of a capture, µs; NaN while one changed.

    Raises
    ------
    InputError
        When a value is no positive number.
    """
    path = as_path(path)
    return parse_exposures(read_text(path), str(path))


def parse_exposures(text: str, file: str) -> Mapping[str, Mapping[str, float]]:
    """Return the exposure times in the text of an exposures.csv as `read_exposures`; messages name the ``file``."""
    exposures: dict[str, dict[str, float]] = {}
    for line in parse_csv(text, file, HEADER):
        name = Path(line.values[0])
        frame = name.stem if name.suffix.lower() in EXTENSIONS else line.values[0]
        exposure_us = line.parse_number(2, "exposure_us") if line.values[2] else float("nan")
        if exposure_us <= 0:
            raise line.error(f"exposure_us {line.values[2]} is not positive; give the time in µs")
        exposures.setdefault(frame, {})[line.values[1]] = exposure_us
    return exposures
