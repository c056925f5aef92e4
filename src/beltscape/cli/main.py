"""The program ``beltscape``: selects the command, runs it, and turns errors into one line and an exit code.

With ``--json`` an error is also printed as a document.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import traceback
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NoReturn, cast

from beltscape import __version__
from beltscape.cli.catalogue import COMMANDS, GROUPS, TITLES, Command, add_examples, load_command
from beltscape.cli.commands import completion
from beltscape.cli.terminal import Terminal, prepare_streams, print_error, print_output
from beltscape.core.errors import (
    ArgumentError,
    BeltscapeError,
    InputError,
    OutputError,
    describe_missing_library,
)
from beltscape.core.system_calls import end_with_beginner

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


class OneLineParser(argparse.ArgumentParser):
    """Parser whose usage errors are one line with the fix."""

    def error(self, message: str) -> NoReturn:
        """Raise UsageError with the message in one line, without the names of Python's types."""
        message = re.sub(r"invalid (float|int) value: (.*)", _describe_no_number, message)
        raise UsageError(f"{self.prog}: {message}; see: {self.prog} --help")


def _describe_no_number(found: re.Match[str]) -> str:
    """Return what a number must be, in place of argparse's message."""
    kind, text = found[1], found[2]
    needed = "a whole number" if kind == "int" else "a number"
    point = ", with a decimal point" if kind == "float" and "," in text else ""
    return f"{text} is not {needed}{point}"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; return the exit code: 0 on success, else that of `beltscape.cli.main`."""
    words = list(sys.argv[1:] if argv is None else argv)
    prepare_streams()
    end_with_beginner()
    try:
        return _run_and_flush(words)
    except (Exception, KeyboardInterrupt) as error:
        return report_failure(error, as_json="--json" in words)


def _run_and_flush(words: Sequence[str]) -> int:
    """Run the program, and see that what argparse prints can be written."""
    try:
        code = _run_command(words)
    except SystemExit:
        print_output("")
        raise
    print_output("")
    return code


def _run_command(words: Sequence[str]) -> int:
    if completion.ASKED in os.environ:
        _complete()
    name = words[0] if words else ""
    if name not in COMMANDS:
        return _run_top_level(words)
    parser = OneLineParser(prog=f"beltscape {name}", description=COMMANDS[name])
    command = _declare(name, parser)
    add_examples(parser, name)
    return _run(command, parser.parse_args(words[1:]))


def _complete() -> None:
    """Answer a shell's question for completions with the arguments of all commands."""
    parser = OneLineParser(prog="beltscape")
    parsers = parser.add_subparsers()
    for name, description in COMMANDS.items():
        _declare(name, parsers.add_parser(name, help=description))
    completion.answer(parser)


def _declare(name: str, parser: argparse.ArgumentParser) -> Command:
    """Declare the arguments of a command; return its module."""
    command = load_command(name)
    command.add_arguments(parser)
    _add_json(parser)
    return command


def _run(command: Command, arguments: argparse.Namespace) -> int:
    from beltscape.cli.output import manage_output
    from beltscape.core.quantities import receive_oddities
    from beltscape.files.json_text import to_json

    _require_working_folder()
    with Terminal() as terminal, manage_output(arguments) as output, receive_oddities(terminal.warn):
        result = {**output.relocate(command.run(arguments, terminal)), "warnings": terminal.warnings}
    text = to_json(result) if arguments.json else command.summary(result) + "\n"
    print_output(text, as_json=arguments.json)
    return 0


def _require_working_folder() -> None:
    """Raise InputError where the folder in which the program was started is gone: relative paths lead nowhere."""
    try:
        Path.cwd()
    except OSError as error:
        raise InputError(
            f"the working folder cannot be used ({error.strerror}): it was removed or moved away; cd to another one"
        ) from error


def _add_json(parser: argparse.ArgumentParser) -> None:
    for action in parser._actions:
        # argparse has no public way to list sub-commands
        if isinstance(action, argparse._SubParsersAction):
            for child in cast("dict[str, argparse.ArgumentParser]", action.choices).values():
                _add_json(child)
            return
    parser.add_argument("--json", action="store_true", help="print the result as one JSON document")


def _run_top_level(words: Sequence[str]) -> int:
    listed = "\n\n".join(_list_group(group) for group in GROUPS)
    parser = OneLineParser(
        prog="beltscape",
        usage="beltscape COMMAND [...]",
        description="Cameras over a conveyor belt become a 3-D sensor for bulk material.",
        epilog=f"{listed}\n\nbeltscape COMMAND --help shows a command's arguments.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"beltscape {__version__}")
    parser.add_argument("command", nargs="?", help=argparse.SUPPRESS)
    arguments, unknown = parser.parse_known_args(words)
    if arguments.command is not None:
        from beltscape.core.errors import suggest_name

        command: str = arguments.command
        hint = suggest_name(command, COMMANDS) or f"there are {', '.join(COMMANDS)}"
        parser.error(f"no command {arguments.command!r}; {hint}")
    if unknown:
        parser.error(f"no option {unknown[0]}")
    parser.print_help()
    return 0


def _list_group(group: str) -> str:
    """Return the heading of a group and its commands, a line each."""
    lines = [f"  {name:<12} {description}" for name, description in GROUPS[group].items()]
    return "\n".join([f"{TITLES[group]}:", *lines])
