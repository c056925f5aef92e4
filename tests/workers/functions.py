"""Functions that the tests run on workers, which import them by name."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from beltscape.core.errors import InputError
from beltscape.core.system_calls import count_usable_cores


def multiply(factor: int, number: int) -> int:
    """Return the product; 13 is an input error, 14 a defect."""
    if number == 13:
        raise InputError("thirteen.png: the file is damaged; copy the image again")
    if number == 14:
        raise ZeroDivisionError("division\nby zero")
    return factor * number


def die_at_first(folder: str, number: int | str) -> int | str:
    """Kill the own process the first time that a task is run."""
    mark = Path(folder) / str(number)
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def die_always(shared: None, task: Any) -> None:
    """Kill the own process."""
    del shared, task
    os.kill(os.getpid(), signal.SIGKILL)


def add_arrays(offset: float, given: dict[str, np.ndarray]) -> tuple[np.ndarray, bool]:
    """Return the sum of arrays and an offset, and whether the first array was writeable."""
    arrays = [*given.values()]
    return np.asarray(sum(arrays) + offset), arrays[0].flags.writeable


def count_cores(shared: None, task: None) -> tuple[int, int, str | None]:
    """Return the numbers of cores that the program, OpenCV and the libraries of linear algebra use."""
    del shared, task
    return count_usable_cores(), cv2.getNumThreads(), os.environ.get("OMP_NUM_THREADS")


def sleep(seconds: float, number: int) -> tuple[int, int]:
    """Take a while; return the process."""
    time.sleep(seconds)
    return number, os.getpid()


@dataclass(frozen=True)
class KillOnce:
    """A function of frames that kills its process the first time that it is given a frame."""

    function: Callable[[Any, Any], Any]
    folder: str

    def __call__(self, shared: Any, task: Any) -> Any:
        """Return what the function returns."""
        die_at_first(self.folder, task.frame_set.frame)
        return self.function(shared, task)
