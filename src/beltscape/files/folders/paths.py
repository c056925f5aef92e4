"""Paths as arguments of Python callers."""

from __future__ import annotations

import os
from pathlib import Path

from beltscape.core.errors import InputError

AnyPath = str | os.PathLike[str]
"""Type of path arguments."""


def as_path(given: AnyPath, argument: str = "path") -> Path:
    """Return the path; InputError with the argument's name if it is none."""
    if isinstance(given, str | os.PathLike) and isinstance(os.fspath(given), str) and os.fspath(given):
        return Path(given)
    raise InputError(f"{argument} = {given!r}: must be a path, as text or pathlib.Path")
