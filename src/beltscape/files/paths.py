"""Files that people give: checks of paths, reading of text with errors in one line, lists of names in messages.

The command line's help imports this module, so it needs the standard library only.
"""

from __future__ import annotations

import os
import re
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from math import inf, isfinite
from pathlib import Path
from typing import cast

from beltscape.core.checks import show_value
from beltscape.core.errors import InputError

AnyPath = str | os.PathLike[str]
"""Type of path arguments."""


def as_path(given: AnyPath, argument: str = "path") -> Path:
    """Return the path; InputError with the argument's name if it is none."""
    if _is_path(given):
        return Path(given)
    raise InputError(f"{argument} = {show_value(given)}: must be a path, as text or pathlib.Path")


def _is_path(given: object) -> bool:
    return isinstance(given, (str, os.PathLike)) and _is_text(os.fspath(cast("AnyPath", given)))


def _is_text(name: object) -> bool:
    return isinstance(name, str) and name != ""


def summarise_names(names: Sequence[str], most: int = 4) -> str:
    """Return the first ``most`` names and the number of the others: messages stay on one line."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
"""A number as tables of other programs write it; Python's float also takes 1_000 and words."""


def read_text(path: Path) -> str:
    """Read a UTF-8 file, with or without a byte order mark; InputError with the reason if it is unreadable."""
    with named_read_errors(path):
        return decode_text(path.read_bytes())


def decode_text(data: bytes) -> str:
    """Decode UTF-8, with or without a byte order mark, with line ends of any kind; UnicodeDecodeError otherwise."""
    return data.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")


@contextmanager
def named_read_errors(path: Path | str, fix: str = "") -> Generator[None]:
    """Turn errors of reading and decoding into InputError with the reason; ``fix`` follows "not UTF-8 text"."""
    try:
        yield
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text{fix and f'; {fix}'}") from error


def parse_decimal(text: str) -> float | None:
    """Return the finite number that a text holds, with a decimal point; None if it holds none."""
    value = float(text) if _NUMBER.fullmatch(text.strip()) else inf
    return value if isfinite(value) else None
