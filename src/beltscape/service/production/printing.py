"""Reports on a printer: the PDF goes to CUPS by its command ``lp``."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from beltscape.core.errors import BeltscapeError
from beltscape.service.production.commands import Pause, run_command

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
