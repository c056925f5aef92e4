"""The worker processes that a test has begun."""

from __future__ import annotations

import os
from pathlib import Path


def find_workers() -> list[int]:
    """Return the worker processes of this process that run, in the order of their numbers."""
    found: list[int] = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            is_worker = b"beltscape.workers.worker_process" in (entry / "cmdline").read_bytes()
            state, parent = read_state(int(entry.name))
        except OSError:  # no process, or one that has ended
            continue
        if is_worker and state != "Z" and parent == os.getpid():
            found.append(int(entry.name))
    return sorted(found)


def is_running(process: int) -> bool:
    """Return whether a process runs, although nobody may have waited for its end."""
    try:
        return read_state(process)[0] != "Z"
    except OSError:
        return False


def read_state(process: int) -> tuple[str, int]:
    """Return the state of a process by its letter, and its parent; OSError if there is none."""
    state, parent = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[:2]
    return state, int(parent)
