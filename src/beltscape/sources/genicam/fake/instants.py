"""Which picture is due: agreed on by the processes of all simulated cameras."""

from __future__ import annotations

import fcntl
import mmap
import struct
from pathlib import Path

LAYOUT = struct.Struct("<qq")
"""Number of the newest instant, camera time of its first image."""


class Instants:
    """Counts instants in a file that all processes share: images that are taken close together are of one."""

    def __init__(self, path: Path, apart_s: float) -> None:
        """An image at least ``apart_s`` after the first of an instant begins the next one; made where not there."""
        self._file = path.open("r+b" if path.exists() else "w+b")
        if path.stat().st_size < LAYOUT.size:
            self._file.write(LAYOUT.pack(-1, 0))
            self._file.flush()
        self._memory = mmap.mmap(self._file.fileno(), LAYOUT.size)
        self._apart_ns = round(apart_s * 1e9)

    def of(self, camera_ns: int) -> int:
        """The instant of an image taken at that time of the cameras' common clock; the first one is 0."""
        fcntl.flock(self._file, fcntl.LOCK_EX)
        try:
            number, since_ns = LAYOUT.unpack(self._memory)
            if number < 0 or camera_ns - since_ns >= self._apart_ns:
                number, since_ns = number + 1, camera_ns
                self._memory[:] = LAYOUT.pack(number, since_ns)
            # this process was held up: another one is already further
            return max(0, number - 1) if since_ns - camera_ns >= self._apart_ns else number
        finally:
            fcntl.flock(self._file, fcntl.LOCK_UN)
