"""One core for each worker of a machine, so that its threads do not take those of other workers."""

from __future__ import annotations

import os
import tempfile
from functools import cache
from pathlib import Path

import cv2

from beltscape.core.system_calls import CORES


@cache
def take_core() -> int | None:
    """Keep this process, until it ends, to a core that no other worker of this user has; return its number.

    Without a free core, and on systems that do not bind processes to cores, only the number of threads is limited.
    """
    os.environ[CORES] = "1"
    cv2.setNumThreads(1)
    if not hasattr(os, "sched_setaffinity"):
        return None
    import fcntl

    folder = Path(tempfile.gettempdir()) / f"beltscape-cores-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    for core in sorted(os.sched_getaffinity(0)):
        lock = os.open(folder / str(core), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # the system frees it when the process ends
        except OSError:
            os.close(lock)
            continue
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setaffinity(int(thread.name), {core})
        return core
    return None
