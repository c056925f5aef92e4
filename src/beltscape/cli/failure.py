"""Reporting of errors: one line on standard error, with ``--json`` also a document, and an exit code."""

from __future__ import annotations

import json
import os
import traceback
from contextlib import suppress
from pathlib import Path

from beltscape.cli.terminal import print_error, print_output
from beltscape.core.errors import ArgumentError, BeltscapeError, OutputError
from beltscape.core.runtime.extras import describe_missing_library

BAD_INPUT, INTERNAL, INTERRUPTED = 2, 70, 130
"""Exit codes: usage or input error, internal error (EX_SOFTWARE of sysexits.h), Ctrl-C."""
TRACEBACK = "BELTSCAPE_TRACEBACK"
"""Environment variable; if it is set, an internal error prints its traceback."""


class UsageError(BeltscapeError):
    """The command line is invalid; the message begins with the program's name."""


def report_failure(error: BaseException, *, as_json: bool) -> int:
    """Print ``error`` as one line and, with ``as_json``, as a document; return the exit code."""
    code, message = _describe(error)
    line = message if isinstance(error, UsageError) else f"beltscape: {message}"
    print_error(line)
    if code == INTERNAL and os.environ.get(TRACEBACK):
        print_error("".join(traceback.format_exception(error)).rstrip())
    if as_json:
        document = {"type": _kind(error, code), "message": message, "exit_code": code}
        with suppress(OutputError):  # the line says what went wrong first
            print_output(json.dumps({"error": document}, indent=1, ensure_ascii=False) + "\n", as_json=True)
    return code


def _kind(error: BaseException, code: int) -> str:
    if code == INTERNAL:
        return "InternalError"
    if isinstance(error, ArgumentError):
        return "InputError"
    return "Interrupted" if code == INTERRUPTED else type(error).__name__


def _describe(error: BaseException) -> tuple[int, str]:
    """Return the exit code and the message in one line."""
    if isinstance(error, BeltscapeError):
        return BAD_INPUT, " ".join(str(error).split("\n"))
    if isinstance(error, KeyboardInterrupt):
        return INTERRUPTED, "interrupted"
    if isinstance(error, OSError) and error.filename is not None:
        return BAD_INPUT, f"{error.filename}: {error.strerror or error}; check that it exists and may be used"
    if isinstance(error, MemoryError):
        return BAD_INPUT, "not enough memory for this; give smaller images or fewer points"
    missing = describe_missing_library(error) if isinstance(error, ImportError) else None
    if missing is not None:
        return BAD_INPUT, missing
    hint = "" if os.environ.get(TRACEBACK) else f"; set {TRACEBACK}=1 to see where, and report it"
    text = " ".join(f"{type(error).__name__}: {error}".split())
    return INTERNAL, f"internal error, a fault of Beltscape ({text} in {_find_origin(error)}){hint}"


def _find_origin(error: BaseException) -> str:
    """Return the file and line of Beltscape in which the error was raised."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "beltscape" in Path(frame.filename).parts] or frames
    return f"{Path(own[-1].filename).name}:{own[-1].lineno}" if own else "an unknown place"
