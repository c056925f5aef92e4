"""Which picture is due: agreed on by the processes of all simulated cameras."""

from __future__ import annotations

import fcntl
import mmap
import struct
from pathlib import Path

LAYOUT = struct.Struct("<qq")
"""Number of the newest instant, the cameras' common time of it."""
FOLLOW = 0.1
"""Share by which the instants follow the images: triggers come a little sooner or later."""


class InstantCounter:
    """Counts instants in a file that all processes share: they are a period offsets_ns, an image is of the nearest one."""

    def __init__(self, path: Path, period_s: float) -> None:
        """``path`` is made where it is not there."""
        self._file = path.open("r+b" if path.exists() else "w+b")
        if path.stat().st_size < LAYOUT.size:
            self._file.write(LAYOUT.pack(-1, 0))
            self._file.flush()
        self._memory = mmap.mmap(self._file.fileno(), LAYOUT.size)
        self._period_ns = round(period_s * 1e9)

    def of(self, camera_ns: int) -> int:
        """The instant of an image taken at that time of the cameras' common clock; the first one is 0."""
        fcntl.flock(self._file, fcntl.LOCK_EX)
        try:
            number, at_ns = LAYOUT.unpack(self._memory)
            if number < 0:
                number, at_ns = 0, camera_ns
            steps = round((camera_ns - at_ns) / self._period_ns)
            off_ns = camera_ns - (at_ns + steps * self._period_ns)
            newest = max(0, steps)  # an image may be of an instant before
            at_ns += newest * self._period_ns + round(FOLLOW * off_ns)
            self._memory[:] = LAYOUT.pack(number + newest, at_ns)
            return max(0, number + steps)
        finally:
            fcntl.flock(self._file, fcntl.LOCK_UN)

    def close(self) -> None:
        """Let go of the file."""
        self._memory.close()
        self._file.close()
