"""Reading of encoder.csv, the belt's positions of a capture: ``frame,timestamp_s,belt_position_mm``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf
from statistics import median

from beltscape.core.errors import InputError
from beltscape.core.quantities import find_motion_faults, report_oddity
from beltscape.files.paths import AnyPath, as_path, read_text
from beltscape.files.times_csv import HEADER as TIMES_HEADER
from beltscape.files.times_csv import parse_instants

_LATEST_NS = 4_102_444_800 * 10**9
"""The beginning of 2100; times of day in ms since 1970 are after it when they are read as seconds."""
HEADER = (*TIMES_HEADER, "belt_position_mm")
LONGEST_ROLL_BACK_MM = 3000.0
"""Longest distance by which a stopped belt rolls back: some metres on a steep belt without a back stop. Chosen."""
_FEWEST_STEPS = 4
"""Steps that tell a regular motion from one by hand. Chosen."""
_FIX = "positions must grow with the travel (--direction sets its sense)"


@dataclass(frozen=True, slots=True)
class BeltReading:
    """Time and belt position of one frame."""

    frame: str
    """The image files' stem."""
    time_ns: int
    belt_position_mm: float
    """Grows with the belt's travel; falls where the belt rolls back."""


def read_encoder(path: AnyPath) -> tuple[BeltReading, ...]:
    """Read encoder.csv; frame names may have the image file's extension.

    Raises
    ------
    InputError
        When there is no such file, a value is not a number, a frame occurs twice, times do not increase, or the belt
        runs back farther than it rolls when it stops.
    """
    path = as_path(path)
    if not path.is_file():
        raise InputError(
            f"{path}: no such file; give another encoder.csv, or none to follow the material's own motion"
        )
    return parse_encoder(read_text(path), str(path))


def parse_encoder(text: str, file: str) -> tuple[BeltReading, ...]:
    """Return the readings in the text of an encoder.csv as `read_encoder`; messages name the ``file``."""
    readings: list[BeltReading] = []
    farthest, lowest = float("-inf"), 0
    for line, frame, time_ns in parse_instants(text, file, HEADER):
        position = line.parse_number(2, "belt_position_mm")
        farthest = max(farthest, position)
        if farthest - position > LONGEST_ROLL_BACK_MM:
            raise line.error(
                f"belt_position_mm {line.values[2]} is {(farthest - position) / 1000:.1f} m behind the farthest "
                f"before it, more than a belt rolls back ({LONGEST_ROLL_BACK_MM / 1000:g} m); {_FIX}"
            )
        readings.append(BeltReading(frame, time_ns, position))
        if position < readings[lowest].belt_position_mm:
            lowest = len(readings) - 1
    if readings and 0 < lowest == len(readings) - 1:
        raise InputError(f"{file}: belt_position_mm falls from the first row to the last; {_FIX}")
    _check_motion(file, readings)
    return tuple(readings)


def _check_motion(file: str, readings: Sequence[BeltReading]) -> None:
    """Raise InputError where times or positions are in another unit, as far as intervals and speeds show it."""
    if any(abs(reading.time_ns) > _LATEST_NS for reading in readings):
        raise InputError(
            f"{file}: timestamp_s {readings[-1].time_ns * 1e-9:.10g} is after the year 2100; give seconds: divide "
            "milliseconds by 1000, nanoseconds by 1e9"
        )
    steps = [
        ((after.time_ns - before.time_ns) * 1e-9, abs(after.belt_position_mm - before.belt_position_mm))
        for before, after in pairwise(readings)
    ]
    moving = [length / seconds for seconds, length in steps if length > 0]
    if not moving:
        return
    intervals = [seconds for seconds, _ in steps]
    spread = max(_find_spread(intervals), _find_spread(moving))
    refusal, oddity = find_motion_faults(median(intervals), median(moving), spread)
    if refusal:
        raise InputError(f"{file}: {refusal}")
    if oddity:
        report_oddity(f"{file}: {oddity}")


def _find_spread(values: Sequence[float]) -> float:
    """Return the median deviation of some values from their median as a share; infinite for too few values."""
    if len(values) < _FEWEST_STEPS:
        return inf
    middle = median(values)
    return median(abs(value - middle) for value in values) / middle
