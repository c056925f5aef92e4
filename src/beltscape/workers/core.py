"""One core for each worker of a machine, so that its threads do not take those of other workers."""

from __future__ import annotations

import os
import tempfile
from functools import cache
from pathlib import Path

import cv2

from beltscape.core.runtime.system_calls import CORES, bind_to_free_core


@cache
def take_core() -> int | None:
    """Keep this process, until it ends, to a core that no other worker of this user has; return its number.

    Without a free core, and on systems that do not bind processes to cores, only the number of threads is limited.
    """
    os.environ[CORES] = "1"
    cv2.setNumThreads(1)
    return bind_to_free_core(Path(tempfile.gettempdir()))
