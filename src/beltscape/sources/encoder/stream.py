"""An encoder whose readings come one after the other."""

from __future__ import annotations

from collections import OrderedDict
from threading import Lock
from time import monotonic_ns

from beltscape.sources.encoder.count import Count
from beltscape.sources.encoder.device_clock import DeviceClock
from beltscape.sources.encoder.origin import Origin
from beltscape.sources.encoder.settings import EncoderSettings
from beltscape.sources.encoder.text import Reading, parse
from beltscape.sources.encoder.track import Track

_FRAMES = 10_000
_RECENT_NS = 60_000_000_000


class Stream:
    """Takes lines from one thread, tells positions to any.

    Positions are the device's own count in mm, signed as the belt moves, so they go on over restarts of the
    program; see `Count` for wraps and resets.
    """

    def __init__(
        self, settings: EncoderSettings, origin: Origin | None = None, resume_mm: float | None = None
    ) -> None:
        self._settings = settings
        self._track = Track(round(settings.silent_s * 1e9))
        self._clock = DeviceClock()
        self._origin = origin
        self._count = Count(settings, 0.0 if origin is None else origin.read_mm(), resume_mm)
        self._frames: OrderedDict[str, tuple[int, float]] = OrderedDict()
        self._lock = Lock()
        self._heard_ns = monotonic_ns()
        self._notices: dict[str, tuple[int, str]] = {}

    def take(self, line: str, arrival_ns: int) -> None:
        """A line that came at a steady time; what is no reading is noted and left out."""
        try:
            reading = parse(line)
        except ValueError as error:
            self.note(
                "line", f"a reading {line[:40]!r} cannot be read ({error}); check what sends it", arrival_ns
            )
            return
        if reading is not None:
            self._take(reading, arrival_ns)

    def _take(self, reading: Reading, arrival_ns: int) -> None:
        time_ns = self._time_ns(reading, arrival_ns)
        if time_ns is None:
            return
        with self._lock:
            jumps = self._count.jumps
            position = self._count.position_mm(reading.count, time_ns)
            self._heard_ns = arrival_ns
            if reading.frame:
                self._frames[reading.frame] = arrival_ns, position
                if len(self._frames) > _FRAMES:
                    self._frames.popitem(last=False)
            jumped = self._count.jumps > jumps
        self._track.add(time_ns, position)
        if jumped:
            self._keep_origin(arrival_ns)

    def _time_ns(self, reading: Reading, arrival_ns: int) -> int | None:
        if reading.stamp_ns is None or self._settings.times == "arrival":
            return arrival_ns
        if self._settings.times == "steady":
            return min(reading.stamp_ns, arrival_ns)
        return self._clock.steady_ns(reading.stamp_ns, arrival_ns)

    def _keep_origin(self, now_ns: int) -> None:
        by = self._count.jump_mm
        self.note(
            "jump", f"its count jumped by {by:.0f} mm; it was reset, or fastest_mm_s is too low", now_ns
        )
        hindered = "" if self._origin is None else self._origin.write_mm(self._count.offset_mm)
        if hindered:
            self.note("origin", hindered, now_ns)

    def note(self, kind: str, text: str, now_ns: int) -> None:
        """Something is wrong; told for a minute."""
        with self._lock:
            self._notices[kind] = (now_ns, text)

    def at(self, time_ns: int | None, frame: str) -> float | None:
        """Position at a frame: the reading that names it, else at its steady time."""
        with self._lock:
            heard_ns, named = self._frames.get(frame, (0, None))
        # a name that came up again after a restart of the cameras is another frame
        if named is not None and (time_ns is None or abs(time_ns - heard_ns) < _RECENT_NS):
            return named
        if time_ns is None:
            return None
        return self._track.at(time_ns, round(self._settings.wait_s * 1e9))

    @property
    def silent_s(self) -> float:
        """Seconds since the last reading that could be used, or since it was opened."""
        with self._lock:
            return max(0, monotonic_ns() - self._heard_ns) * 1e-9

    @property
    def trouble(self) -> str:
        """What was wrong within the last minute; running backwards for as long as it does."""
        now_ns = monotonic_ns()
        with self._lock:
            back = self._count.back_mm
            recent = [text for since, text in self._notices.values() if now_ns - since < _RECENT_NS]
        if back:
            return f"the belt runs backwards by {back:.0f} mm; turn the encoder's wires, or set reverse"
        return recent[0] if recent else ""

    def close(self) -> None:
        """Nobody waits any longer."""
        self._track.close()
