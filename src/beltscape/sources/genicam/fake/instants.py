"""The counter of trigger instants that the processes of all simulated cameras share."""

from __future__ import annotations

import fcntl
import mmap
import struct
from pathlib import Path

LAYOUT = struct.Struct("<qq")
"""Number of the newest instant, and its time on the cameras' common clock."""
FOLLOW = 0.1
"""Gain by which the instants follow the images: triggers come slightly early or late."""


class InstantCounter:
    """Counts instants in a shared file; they are one period apart, and an image belongs to the nearest one."""

    def __init__(self, path: Path, period_s: float) -> None:
        """Open the file ``path``, or create it."""
        self._file = path.open("r+b" if path.exists() else "w+b")
        if path.stat().st_size < LAYOUT.size:
            self._file.write(LAYOUT.pack(-1, 0))
            self._file.flush()
        self._memory = mmap.mmap(self._file.fileno(), LAYOUT.size)
        self._period_ns = round(period_s * 1e9)

    def number_at(self, camera_ns: int) -> int:
        """Return the number of the instant of an image at that time of the cameras' common clock, from 0."""
        fcntl.flock(self._file, fcntl.LOCK_EX)
        try:
            number, at_ns = LAYOUT.unpack(self._memory)
            if number < 0:
                number, at_ns = 0, camera_ns
            steps = round((camera_ns - at_ns) / self._period_ns)
            offset_ns = camera_ns - (at_ns + steps * self._period_ns)
            newest = max(0, steps)  # an image may belong to an earlier instant
            at_ns += newest * self._period_ns + round(FOLLOW * offset_ns)
            self._memory[:] = LAYOUT.pack(number + newest, at_ns)
            return max(0, number + steps)
        finally:
            fcntl.flock(self._file, fcntl.LOCK_UN)

    def close(self) -> None:
        """Close the file."""
        self._memory.close()
        self._file.close()
