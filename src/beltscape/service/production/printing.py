"""Reports on a printer: the PDF goes to CUPS by its command ``lp``.

Commands of other programs run with a time limit and without a shell, and end when the calling thread is to end.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import IO

from beltscape.core.errors import BeltscapeError

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


UNPRINTED, PRINTED = ".unprinted", ".printed"
"""Endings of the marks of a report that is to be printed, and of one that was."""
DEFAULT = "default"
"""Stands for the default printer of the system."""
_TIMEOUT_S = 30.0
"""Time for a command of CUPS; it answers at once unless its server hangs, and then waits for minutes."""
_TITLE_MAX = 120
"""Longest title of a job, characters; CUPS cuts names at 255 bytes."""


class PrintError(BeltscapeError):
    """The printer did not take a report; it is offered again."""


def check_printer(printer: str, pause: Pause | None = None) -> str:
    """Return the name of the printer that would print.

    Raises
    ------
    PrintError
        If a command of CUPS is missing or fails, or there is no such printer.
    """
    _find_command("lp")
    if printer == DEFAULT:
        found = _run(["lpstat", "-d"], pause).partition(":")[2].strip()
        if not found:
            fix = "name one of those that lpstat -e lists, or set one by lpadmin -d NAME"
            raise PrintError(f'[reports] printer = "{DEFAULT}": the system has no default printer; {fix}')
        return found
    _run(
        ["lpstat", "-p", printer],
        pause,
        f'printer = "{printer}": CUPS does not know it (lpstat -e lists all)',
    )
    return printer


def print_report(printer: str, pdf: Path, title: str, pause: Pause | None = None) -> None:
    """Hand a PDF to the printer's queue; it is printed when the printer can.

    Raises
    ------
    PrintError
        If ``lp`` is missing, refuses it, or does not end in time. It may then have been taken all the same.
    """
    words = "".join(letter if letter.isprintable() else " " for letter in title).split()
    chosen = [] if printer == DEFAULT else ["-d", printer]
    _run(["lp", *chosen, "-t", " ".join(words)[:_TITLE_MAX], "--", str(pdf.resolve())], pause)


def _find_command(name: str) -> str:
    path = shutil.which(name)
    if path is None:
        raise PrintError(f"[reports] printer: the command {name} is missing; run: apt install cups-client")
    return path


def _run(command: Sequence[str], pause: Pause | None, meaning: str = "") -> str:
    """Return what a command prints in one line; PrintError with its own words where it fails or takes too long."""
    path = _find_command(command[0])
    try:
        done = run_command([path, *command[1:]], _TIMEOUT_S, pause)
    except OSError as error:
        raise PrintError(f"[reports] printer: {path}: cannot be run ({error.strerror})") from error
    if done is None:
        raise PrintError(f"[reports] printer: {command[0]} does not answer and was ended; is CUPS running?")
    if done.code:
        reason = " ".join((done.errors or done.output).split()) or f"{command[0]} ends with code {done.code}"
        raise PrintError(f"[reports] {meaning or 'printer'}: {reason[:200]}")
    return " ".join(done.output.split())
