"""One call of a task's function, on whichever worker, with its time and its failure."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable
from typing import Any

from beltscape.core.errors import BeltscapeError
from beltscape.workers.tasks import Completed


def call(function: Callable[[Any, Any], Any], shared: Any, number: int, task: Any) -> Completed[Any]:
    """Run a task; its exception becomes its failure in one line."""
    begin_s, clock_s = time.time(), time.perf_counter()
    value, failure = None, ""
    try:
        value = function(shared, task)
    except BeltscapeError as error:
        failure = str(error)
    except Exception as error:
        failure = f"{type(error).__name__}: {error}".splitlines()[0]
    worker = f"{socket.gethostname()}/{os.getpid()}"
    return Completed(number, value, failure, worker, begin_s, time.perf_counter() - clock_s)
