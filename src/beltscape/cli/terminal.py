"""The command line's streams, whatever their encoding and state, and its reporter of progress and warnings."""

from __future__ import annotations

import codecs
import os
import sys
import unicodedata
from collections.abc import Mapping
from io import TextIOWrapper
from math import isfinite
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, TextIO

from beltscape.core.errors import OutputError

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID


_SPELLED = {
    **{"σ": "sigma", "Σ": "Sigma", "μ": "u", "µ": "u", "α": "alpha", "λ": "lambda", "°": " deg", "±": "+/-"},
    **{
        "×": "x",
        "·": "*",
        "−": "-",
        "–": "-",
        "—": "-",
        "≤": "<=",
        "≥": ">=",
        "→": "->",
        "←": "<-",
        "√": "sqrt",
    },
    **{"‘": "'", "’": "'", "“": '"', "”": '"', "█": "#", "─": "-", "│": "|"},
}
"""Characters of the program's texts that compatibility decomposition does not turn into ASCII."""
_SPELL, _ESCAPE = "beltscape.spell", "beltscape.escape"
"""Names of the handlers of characters that an encoding lacks: in text, and in JSON."""


def prepare_streams() -> None:
    """Let standard output and standard error take every character; one that the caller has closed takes all."""
    codecs.register_error(_SPELL, _spell)
    codecs.register_error(_ESCAPE, _escape)
    for name in ("stdout", "stderr"):
        stream: TextIO | None = getattr(sys, name)
        if stream is None:
            stream = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115
            setattr(sys, name, stream)
        _set_errors(stream, _SPELL)


def print_error(line: str) -> None:
    """Print a line on standard error; where nobody takes it, it is lost and the program goes on."""
    try:
        print(line, file=sys.stderr, flush=True)
    except OSError:
        _discard(sys.stderr)


def print_output(text: str, *, as_json: bool = False) -> None:
    """Write text to standard output, and everything that was written before. Quiet where its reader has left.

    Raises
    ------
    OutputError
        If it cannot be written, such as on a full disk.
    """
    if as_json:
        _set_errors(sys.stdout, _ESCAPE)
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        _discard(sys.stdout)
    except OSError as error:
        _discard(sys.stdout)
        raise OutputError(
            f"standard output: cannot be written ({error.strerror}); check where it goes, the result is lost"
        ) from error


def _set_errors(stream: TextIO, errors: str) -> None:
    if isinstance(stream, TextIOWrapper):
        stream.reconfigure(errors=errors)


def _discard(stream: TextIO) -> None:
    """Let a stream that cannot be written take everything, also what waits in its buffer."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, stream.fileno())
    os.close(null)


def _spell(error: UnicodeError) -> tuple[str, int]:
    """Replace characters by letters that mean the same, or by their number."""
    assert isinstance(error, UnicodeEncodeError)
    return "".join(map(_spell_character, error.object[error.start : error.end])), error.end


def _spell_character(character: str) -> str:
    spelled = _SPELLED.get(character) or unicodedata.normalize("NFKD", character)
    plain = "".join(one for one in spelled if not unicodedata.combining(one))
    return plain if plain.isascii() else character.encode("ascii", "backslashreplace").decode()


def _escape(error: UnicodeError) -> tuple[str, int]:
    """Replace characters by JSON's escapes, so that a reader gets the same text."""
    assert isinstance(error, UnicodeEncodeError)
    units = error.object[error.start : error.end].encode("utf-16-be", "surrogatepass")
    return "".join(f"\\u{units[k : k + 2].hex()}" for k in range(0, len(units), 2)), error.end


class Terminal:
    """Reporter that shows progress bars on a terminal, and one line per finished stage elsewhere."""

    def __init__(self) -> None:
        self.warnings: list[str] = []
        self._bars: Progress | None = None
        self._tasks: dict[str, TaskID] = {}

    def __enter__(self) -> Terminal:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

            self._bars = Progress(
                TextColumn("{task.description:<28}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
                console=Console(stderr=True),
            )  # fmt: skip
            self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bars is not None:
            self._bars.stop()

    def step(self, stage: str, done: int, total: int) -> None:
        """Update the progress of a stage."""
        if self._bars is None:
            if done == total:
                print_error(f"{stage}: {total} done")
            return
        if stage not in self._tasks:
            self._tasks[stage] = self._bars.add_task(stage, total=total)
        self._bars.update(self._tasks[stage], completed=done, total=total)

    def warn(self, message: str) -> None:
        """Print a warning in one line on standard error, each only once."""
        if message in self.warnings:
            return
        self.warnings.append(message)
        line = f"warning: {message}"
        if self._bars is None:
            print_error(line)
        else:
            self._bars.console.print(line, style="yellow", highlight=False, soft_wrap=True, markup=False)


def format_squares(score: Mapping[str, Any]) -> str:
    """Return the error of triangulated squares, or that none was."""
    if not isfinite(score["square_rms_mm"]):
        return "no square seen by two cameras"
    return f"square edge {score['square_bias_mm']:+z.4f} mm, RMS {score['square_rms_mm']:.4f} mm"


def format_findings(fit: Mapping[str, Any]) -> list[str]:
    """Return the findings against a fit, one line each below a heading; empty for a sound fit."""
    return (
        ["The fit is in doubt:", *(f"- {finding}" for finding in fit["doubts"]), ""] if fit["doubts"] else []
    )
