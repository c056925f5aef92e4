"""Space held back for the day the disk is full."""

from __future__ import annotations

import os
import shutil
from pathlib import Path


class Reserve:
    """A file without content that is given up when nothing else is free."""

    def __init__(self, path: Path, size_bytes: int) -> None:
        """At ``path``; nothing is made yet."""
        self.path, self.size_bytes = path, size_bytes

    @property
    def held(self) -> bool:
        """Whether it is there in full."""
        try:
            return self.path.stat().st_size >= self.size_bytes
        except OSError:
            return False

    def free_bytes(self) -> int:
        """What the disk has left; 0 where that cannot be told."""
        try:
            return shutil.disk_usage(self.path.parent).free
        except OSError:
            return 0

    def make(self) -> bool:
        """Hold it, where the disk has twice as much free; whether it is held now."""
        if self.held:
            return True
        if self.free_bytes() < 2 * self.size_bytes:
            return False
        try:
            with self.path.open("wb") as file:
                os.posix_fallocate(file.fileno(), 0, self.size_bytes)
        except OSError:
            self.release()
        return self.held

    def release(self) -> bool:
        """Give it up; whether there was something to give."""
        try:
            self.path.unlink()
        except OSError:
            return False
        return True
