"""Paths as Python callers give them."""

from __future__ import annotations

import os
from pathlib import Path

from beltscape.core.errors import InputError

AnyPath = str | os.PathLike[str]
"""What functions that read or write files take."""


def as_path(given: AnyPath, argument: str = "path") -> Path:
    """Return the path, or InputError naming the argument where it is none."""
    if isinstance(given, str | os.PathLike) and isinstance(os.fspath(given), str) and os.fspath(given):
        return Path(given)
    raise InputError(f"{argument} = {given!r}: must be a path, as text or pathlib.Path")
