"""An encoder whose readings arrive one after the other as lines of text.

A line is parsed, the timestamps of another machine are converted to this machine's monotonic clock, and the offset in
encoder.json, which is kept over restarts of the program, is added to the count.
"""

from __future__ import annotations

import json
import math
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from time import monotonic_ns

from beltscape.core.errors import OutputError
from beltscape.files.atomic import keep_state, read_state
from beltscape.files.encoder_csv import HEADER
from beltscape.files.images import EXTENSIONS
from beltscape.files.paths import parse_decimal
from beltscape.sources.encoder.settings import EncoderSettings
from beltscape.sources.encoder.track import CountUnwrapper, PositionTrack

LONGEST_LINE = 256
"""Characters of a line; a longer one is no reading: name, timestamp and position have some 100."""
_LARGEST_NUMBER = 1e15
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
    if len(line) > LONGEST_LINE or len(cells) > 3:
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
    if value is None or abs(value) > _LARGEST_NUMBER:
        raise ValueError(f"{text!r} is no number")
    return value


_FASTEST_NS = 10_000_000_000
"""Half of the time in which the fastest message counts; at 100 ppm the clocks drift by 2 ms in 20 s."""
_SPEED_NS = 1_000_000_000
"""Time over which the timestamps' speed is measured."""
_SET_BACK_NS = 1_000_000_000
"""Timestamps that go back by less belong to messages out of order; clocks are set back by more."""


@dataclass(slots=True)
class DeviceClock:
    """Clock offset by the least delay: the fastest message of the last 10 to 20 s determines it.

    The remaining error is that message's own delay and the clocks' drift over that time (2 ms at 100 ppm). See
    Cristian 1989, 10.1007/BF01784024; messages go one way only, so delay and offset cannot be separated.
    """

    _stamp_ns: int | None = None
    _since_ns: int = 0
    _least_ns: int | None = None
    _least_before_ns: int | None = None
    _step: tuple[int, int] | None = None
    """Timestamp and arrival at the beginning of the present step."""

    def find_speed(self, stamp_ns: int, arrival_ns: int) -> float:
        """Return the speed of the timestamps over that of this machine's clock, in seconds' steps; 0 between them."""
        if self._step is None:
            self._step = (stamp_ns, arrival_ns)
        stamp, arrival = self._step
        if arrival_ns - arrival < _SPEED_NS:
            return 0.0
        self._step = (stamp_ns, arrival_ns)
        return (stamp_ns - stamp) / (arrival_ns - arrival)

    def steady_ns(self, stamp_ns: int, arrival_ns: int) -> int | None:
        """Return the monotonic time of a timestamp, never after its arrival; None for one out of order."""
        if self._stamp_ns is not None and stamp_ns < self._stamp_ns:
            if self._stamp_ns - stamp_ns < _SET_BACK_NS:
                return None
            self._least_ns = self._least_before_ns = None  # the device's clock was set back
        self._stamp_ns = stamp_ns
        if arrival_ns - self._since_ns > _FASTEST_NS:
            self._least_before_ns, self._least_ns, self._since_ns = self._least_ns, None, arrival_ns
        delay_ns = arrival_ns - stamp_ns
        self._least_ns = delay_ns if self._least_ns is None else min(delay_ns, self._least_ns)
        delays_ns = [value for value in (self._least_ns, self._least_before_ns) if value is not None]
        return stamp_ns + min(delays_ns)


OFFSET_FORMAT = "beltscape-encoder/1"


class EncoderOffset:
    """The stored offset of one encoder; a damaged file, and one of another encoder, counts as none."""

    def __init__(self, path: Path, settings: EncoderSettings) -> None:
        self._path = path
        self.trouble = ""
        """Why a stored offset is not known, in one line; empty: it is, or there was none."""
        self._identity = {
            "format": OFFSET_FORMAT,
            "kind": settings.kind,
            "mm_per_count": settings.mm_per_count,
            "counter_bits": settings.counter_bits,
            "reverse": settings.reverse,
        }

    def read_mm(self) -> float:
        """Return the offset; 0 without a stored one. A damaged file is set aside, see ``trouble``."""
        instead = "without the offset positions go on at the ledger's end"
        offset_mm, self.trouble = read_state(self._path, self._parse, instead)
        return offset_mm or 0.0

    def _parse(self, data: bytes) -> float:
        document = json.loads(data)
        offset_mm = document["offset_mm"]
        if type(offset_mm) not in (int, float) or not math.isfinite(offset_mm):
            raise ValueError("offset_mm")
        is_same = {key: document[key] for key in self._identity} == self._identity
        return float(offset_mm) if is_same else 0.0

    def write_mm(self, offset_mm: float) -> str:
        """Store the offset; return the reason of a failure in one line, or an empty text."""
        try:
            keep_state(self._path, (json.dumps({**self._identity, "offset_mm": offset_mm}) + "\n").encode())
        except OutputError as error:
            return str(error)
        return ""


_FRAMES = 10_000
"""Number of readings with a frame's name that are kept, which bounds the memory."""
_RECENT_NS = 60_000_000_000
"""Time for which a notice is reported, and within which a reading with a frame's name belongs to that frame."""
_FAST_CLOCK = 50.0
"""Speed of timestamps over that of this machine's clock beyond which their unit is not the second; readings that were
delayed and arrive at once reach 10. Chosen."""
_CLOCK_TEXT = (
    "its timestamps run {fast:.0f} times as fast as this machine's clock; in {unit}? send seconds, or set "
    'times = "arrival"'
)
_QUOTED = 40
"""Number of characters of a wrong line that its notice quotes."""


class ReadingStream:
    """Converts lines, added by one thread, to positions, read by any.

    Positions are the device's own count in mm, signed as the belt moves, so they continue over restarts of the
    program; see `CountUnwrapper` for wraps and resets.
    """

    def __init__(
        self, settings: EncoderSettings, offset: EncoderOffset | None = None, resume_mm: float | None = None
    ) -> None:
        self._settings = settings
        self._track = PositionTrack(round(settings.silent_s * 1e9))
        self._clock = DeviceClock()
        self._offset = offset
        self._count = CountUnwrapper(settings, 0.0 if offset is None else offset.read_mm(), resume_mm)
        self._frames: OrderedDict[str, tuple[int, float]] = OrderedDict()
        self._is_stamped = False
        """Whether a timestamp with a decimal point came."""
        self._lock = Lock()
        self._last_reading_ns = monotonic_ns()
        self._notices: dict[str, tuple[int, str]] = {}
        if offset is not None and offset.trouble:
            self.add_notice("offset", offset.trouble, self._last_reading_ns)

    def add_line(self, line: str, arrival_ns: int) -> None:
        """Add a line that arrived at a monotonic time; a line that is no reading is skipped with a notice."""
        try:
            reading = parse_reading(line, is_stamped=self._is_stamped)
        except ValueError as error:
            self.add_notice(
                "line",
                f"a reading {line[:_QUOTED]!r} cannot be read ({error}); check what sends it",
                arrival_ns,
            )
            return
        if reading is not None:
            self._is_stamped = self._is_stamped or (reading.stamp_ns is not None and "." in line)
            self._add_reading(reading, arrival_ns)

    def _add_reading(self, reading: Reading, arrival_ns: int) -> None:
        time_ns = self._time_ns(reading, arrival_ns)
        if time_ns is None:
            return
        with self._lock:
            jumps = self._count.jumps
            position = self._count.position_mm(reading.count, time_ns)
            self._last_reading_ns = arrival_ns
            if reading.frame:
                self._frames[reading.frame] = arrival_ns, position
                if len(self._frames) > _FRAMES:
                    self._frames.popitem(last=False)
            has_jumped = self._count.jumps > jumps
        self._track.add(time_ns, position)
        if has_jumped:
            self._save_offset(arrival_ns)

    def _time_ns(self, reading: Reading, arrival_ns: int) -> int | None:
        if reading.stamp_ns is None or self._settings.times == "arrival":
            return arrival_ns
        if (fast := self._clock.find_speed(reading.stamp_ns, arrival_ns)) > _FAST_CLOCK:
            unit = "milliseconds" if fast < 3e4 else "microseconds" if fast < 3e7 else "nanoseconds"
            self.add_notice("clock", _CLOCK_TEXT.format(fast=fast, unit=unit), arrival_ns)
        if self._settings.times == "steady":
            return min(reading.stamp_ns, arrival_ns)
        return self._clock.steady_ns(reading.stamp_ns, arrival_ns)

    def _save_offset(self, now_ns: int) -> None:
        jump_mm = self._count.jump_mm
        self.add_notice(
            "jump", f"its count jumped by {jump_mm:.0f} mm; it was reset, or fastest_mm_s is too low", now_ns
        )
        failure = "" if self._offset is None else self._offset.write_mm(self._count.offset_mm)
        if failure:
            self.add_notice("offset", failure, now_ns)

    def add_failure(self, failure: str) -> None:
        """Report that the thread that reads the encoder failed and starts again."""
        self.add_notice("failure", f"reading it failed ({failure}) and starts again", monotonic_ns())

    def add_notice(self, kind: str, text: str, now_ns: int) -> None:
        """Add a fault to ``trouble`` for one minute."""
        with self._lock:
            self._notices[kind] = (now_ns, text)

    def position_at(self, time_ns: int | None, frame: str) -> float | None:
        """Return the position at a frame: by the reading that names it, else by its monotonic time."""
        with self._lock:
            named_ns, named = self._frames.get(frame, (0, None))
        # a name that is used again after a restart of the cameras is another frame
        if named is not None and (time_ns is None or abs(time_ns - named_ns) < _RECENT_NS):
            return named
        if time_ns is None:
            return None
        return self._track.position_at(time_ns, round(self._settings.wait_s * 1e9))

    @property
    def silent_s(self) -> float:
        """Seconds since the last usable reading, or since opening."""
        with self._lock:
            return max(0, monotonic_ns() - self._last_reading_ns) * 1e-9

    @property
    def trouble(self) -> str:
        """The fault of the last minute, in one line; running backwards for as long as it lasts."""
        now_ns = monotonic_ns()
        with self._lock:
            back = self._count.back_mm
            recent = [text for since, text in self._notices.values() if now_ns - since < _RECENT_NS]
        if back:
            return f"the belt runs backwards by {back:.0f} mm; turn the encoder's wires, or set reverse"
        return recent[0] if recent else ""

    def close(self) -> None:
        """End all waits for readings."""
        self._track.close()
