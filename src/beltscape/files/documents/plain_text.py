"""Reading of text files with errors in one line."""

from __future__ import annotations

import re
from collections.abc import Generator
from contextlib import contextmanager
from math import inf, isfinite
from pathlib import Path

from beltscape.core.errors import InputError

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
