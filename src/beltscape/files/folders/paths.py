"""Checks of paths that Python callers pass, and lists of names in messages."""

from __future__ import annotations

import os
from collections.abc import Sequence
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
    return isinstance(given, str | os.PathLike) and _is_text(os.fspath(cast("AnyPath", given)))


def _is_text(name: object) -> bool:
    return isinstance(name, str) and name != ""


def summarise_names(names: Sequence[str], most: int = 4) -> str:
    """Return the first ``most`` names and the number of the others: messages stay on one line."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
