"""The worker processes that a test has begun."""

from __future__ import annotations

import os
from pathlib import Path


def find_workers() -> list[int]:
    """Return the worker processes of this process that run, in the order of their numbers."""
    found: list[int] = []
    for entry in Path("/proc").iterdir():
        try:
            is_worker = b"beltscape.workers.worker_process" in (entry / "cmdline").read_bytes()
            state, parent = (entry / "stat").read_text().rpartition(")")[2].split()[:2]
        except OSError:  # no process, or one that has ended
            continue
        if is_worker and state != "Z" and int(parent) == os.getpid():
            found.append(int(entry.name))
    return sorted(found)


def is_running(process: int) -> bool:
    """Return whether a process runs, although nobody may have waited for its end."""
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"
