"""Progress of a training on the terminal: a line for every step, with the time since its start."""

from __future__ import annotations

import time


class PrintedProgress:
    """A reporter whose output can be kept as a log."""

    def __init__(self) -> None:
        self._start = time.monotonic()

    def step(self, stage: str, done: int, total: int) -> None:
        """Print a step."""
        print(f"{time.monotonic() - self._start:7.0f} s  {stage} {done}/{total}", flush=True)

    def warn(self, message: str) -> None:
        """Print a warning."""
        print(f"warning: {message}", flush=True)
