"""Reserved disk space, which is released when the disk is full."""

from __future__ import annotations

import shutil
from pathlib import Path

from beltscape.core.runtime.system_calls import reserve_space


class Reserve:
    """A file without content that is deleted when no other space is free."""

    def __init__(self, path: Path, size_bytes: int) -> None:
        """Reserve space at ``path``; nothing is allocated yet."""
        self.path, self.size_bytes = path, size_bytes

    @property
    def is_held(self) -> bool:
        """True if the whole reserve is allocated."""
        try:
            return self.path.stat().st_size >= self.size_bytes
        except OSError:
            return False

    def free_bytes(self) -> int:
        """Return the free bytes of the disk; 0 if they are unknown."""
        try:
            return shutil.disk_usage(self.path.parent).free
        except OSError:
            return 0

    def allocate(self) -> bool:
        """Allocate the reserve if the disk has twice as much free; return whether it is allocated."""
        if self.is_held:
            return True
        if self.free_bytes() < 2 * self.size_bytes:
            return False
        try:
            with self.path.open("wb") as file:
                reserve_space(file, self.size_bytes)
        except OSError:
            self.release()
        return self.is_held

    def release(self) -> bool:
        """Delete the reserve; return whether there was one."""
        try:
            self.path.unlink()
        except OSError:
            return False
        return True
