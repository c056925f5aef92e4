"""The program as the manual's tests call it, and the options that its parsers declare."""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import signal
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from beltscape.cli.catalogue import COMMANDS, load_command
from beltscape.cli.main import OneLineParser, main
from tests.charts import leave_out_narrow_charts

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@dataclass(frozen=True, slots=True)
class Answer:
    """What a call gave."""

    code: int
    out: str
    err: str


@cache
def parser_of(command: str) -> argparse.ArgumentParser:
    """Return the parser of a command."""
    parser = OneLineParser(prog=f"beltscape {command}")
    load_command(command).add_arguments(parser)
    parser.add_argument("--json", action="store_true")
    return parser


def narrowed(words: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser of the innermost subcommand that the words name.

    Raises
    ------
    LookupError
        Where there is no such command or subcommand.
    """
    if words[0] not in COMMANDS:
        raise LookupError(f"no command {words[0]!r}")
    parser, rest = parser_of(words[0]), list(words[1:])
    while True:
        children = [one for one in parser._actions if isinstance(one, argparse._SubParsersAction)]
        if not children or not rest:
            return parser
        choices, name = children[0].choices, rest.pop(0)
        if name not in choices:
            raise LookupError(f"beltscape {words[0]}: no {name!r}")
        parser = choices[name]


def unknown_options(words: Sequence[str]) -> list[str]:
    """Return the options among the words that their parser does not have by this very name."""
    known = {"--json", "--help", *narrowed(words)._option_string_actions}
    return [word for word in words if word.startswith("--") and word.partition("=")[0] not in known]


def call(words: Sequence[str], folder: Path) -> Answer:
    """Run the program in a folder; its reports have no charts for phones."""
    out, err = io.StringIO(), io.StringIO()
    with (
        leave_out_narrow_charts(),
        _where_it_was(),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        os.chdir(folder)
        try:
            code = main(list(words))
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else 1
    return Answer(code, out.getvalue(), err.getvalue())


@contextlib.contextmanager
def _where_it_was() -> Generator[None]:
    """Bring folder, signals back."""
    folder, handlers = Path.cwd(), [signal.getsignal(number) for number in _SIGNALS]
    try:
        yield
    finally:
        os.chdir(folder)
        for number, handler in zip(_SIGNALS, handlers, strict=True):
            signal.signal(number, handler)
