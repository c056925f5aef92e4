"""Commands of other programs that a thread runs: with a time limit, ended when the thread is to end, no shell."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic
from typing import IO

_POLL_S = 0.05
"""Interval at which the end of a command is looked for."""
_TEXT_MAX = 65_536
"""Most bytes that are read of what a command prints."""

Pause = Callable[[float], bool]
"""Waits for some seconds; returns whether to give up, as `threading.Event.wait` does."""


@dataclass(frozen=True, slots=True)
class Finished:
    """The end of a command."""

    code: int
    """0: it succeeded."""
    output: str
    errors: str


def run_command(line: Sequence[str], timeout_s: float, pause: Pause | None = None) -> Finished | None:
    """Run a command and return its end; None where it did not end in time, or before ``pause`` gave up.

    It and what it has started are then killed. OSError if it cannot be run.
    """
    environment = {**os.environ, "LC_ALL": "C.UTF-8"}
    # files, not pipes: a child that the command leaves behind would hold a pipe open
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            list(line),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=errors,
            env=environment,
            start_new_session=True,
        )
        if not _wait(process, timeout_s, pause):
            return None
        return Finished(process.returncode, _read(output), _read(errors))


def _wait(process: subprocess.Popen[bytes], timeout_s: float, pause: Pause | None) -> bool:
    """Return whether a process ended by itself; otherwise end it and what it has started."""
    end_s = monotonic() + timeout_s
    while monotonic() < end_s:
        with suppress(subprocess.TimeoutExpired):
            process.wait(_POLL_S)
            return True
        if pause is not None and pause(0.0):
            break
    with suppress(OSError):
        if os.name == "posix":
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
    process.wait()
    return False


def _read(file: IO[bytes]) -> str:
    """Return the beginning of a file."""
    file.seek(0)
    return file.read(_TEXT_MAX).decode("utf-8", "replace")
