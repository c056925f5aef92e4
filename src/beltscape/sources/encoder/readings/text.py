"""Parsing of one encoder reading from a line of text."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from beltscape.files.documents.plain_text import parse_decimal
from beltscape.files.rasters.images import EXTENSIONS
from beltscape.files.tables.encoder_csv import HEADER

LONGEST = 256
"""Characters of a line; a longer one is no reading: name, timestamp and position have some 100."""
_LARGEST = 1e15
"""Largest number: whole counts are exact in a double up to 9e15."""


@dataclass(frozen=True, slots=True)
class Reading:
    """The content of one line."""

    count: float
    """The device's raw count or position."""
    stamp_ns: int | None
    """Its timestamp, on any clock."""
    frame: str
    """Name of its frame; empty without one."""


def parse_reading(line: str, *, is_stamped: bool = False) -> Reading | None:
    """Parse ``position``, ``timestamp,position`` or ``frame,timestamp,position``; None for an empty line or a header.

    A timestamp without a decimal point may be a position with a decimal comma: it is refused unless the stream
    ``is_stamped``, by an earlier timestamp with a point.

    Raises
    ------
    ValueError
        When it is none of these.
    """
    cells = [cell.strip() for cell in line.split(",")]
    if not any(cells) or cells[0].lower() in (HEADER[0], HEADER[1], HEADER[2], "position"):
        return None
    if len(line) > LONGEST or len(cells) > 3:
        raise ValueError("not position, timestamp,position or frame,timestamp,position, with decimal points")
    *before, last = cells
    stamp_ns = round(_parse_number(before[-1]) * 1e9) if before else None
    if not is_stamped and before and _may_be_decimal_comma(before[-1], last):
        raise ValueError(
            f"a decimal comma? send {before[-1]}.{last}; a timestamp has a decimal point, as {before[-1]}.0,{last}"
        )
    return Reading(_parse_number(last), stamp_ns, _frame_name(before[0]) if len(before) == 2 else "")


def _may_be_decimal_comma(stamp: str, position: str) -> bool:
    """Return whether two texts may be one number with a decimal comma, other than 0."""
    is_whole = stamp.lstrip("+-").isdecimal() and position.isdecimal()
    return is_whole and bool(stamp.strip("+-0") or position.strip("0"))


def _frame_name(text: str) -> str:
    """Return a frame's name without its image file's extension."""
    name = Path(text)
    return name.stem if name.suffix.lower() in EXTENSIONS else text


def _parse_number(text: str) -> float:
    value = parse_decimal(text)
    if value is None or abs(value) > _LARGEST:
        raise ValueError(f"{text!r} is no number")
    return value
