"""An encoder whose readings arrive one after the other as lines of text."""

from __future__ import annotations

from collections import OrderedDict
from threading import Lock
from time import monotonic_ns

from beltscape.sources.encoder.offset import EncoderOffset
from beltscape.sources.encoder.readings.count import CountUnwrapper
from beltscape.sources.encoder.readings.device_clock import DeviceClock
from beltscape.sources.encoder.readings.text import Reading, parse_reading
from beltscape.sources.encoder.readings.track import PositionTrack
from beltscape.sources.encoder.settings import EncoderSettings

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
