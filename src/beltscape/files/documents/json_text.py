"""Reading and writing of JSON with stable key order and full float precision; NaN becomes null."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError
from beltscape.core.type_guards import is_list_or_tuple, is_mapping
from beltscape.files.documents.plain_text import read_text
from beltscape.files.folders.atomic import write_text

_LARGEST = float(np.finfo(np.float64).max)
"""Largest number of a double; a JSON document may hold longer ones, and comparison with it excludes NaN, too."""


def to_plain(value: Any) -> Any:
    """Convert arrays, NumPy scalars, tuples, paths and NaN to types of JSON."""
    if is_mapping(value):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return to_plain(value.tolist())
    if is_list_or_tuple(value):
        return [to_plain(item) for item in value]
    if isinstance(value, np.generic):
        return to_plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Path):
        return str(value)
    return value


def parse_numbers(value: Any, *shape: int) -> NDArray[np.float64] | None:
    """Return the finite numbers of a JSON value as an array of that shape; None if it holds anything else.

    Texts and truth values are none, which NumPy would convert.
    """
    try:
        items = np.array(value, dtype=object)
    except ValueError:  # lists of unequal depth
        return None
    is_whole = items.shape == shape and all(
        isinstance(item, int | float) and not isinstance(item, bool) and abs(item) <= _LARGEST
        for item in items.ravel()
    )
    return items.astype(np.float64) if is_whole else None


def to_json(value: Any) -> str:
    """Return ``value`` as an indented JSON document, in the order of its keys."""
    return json.dumps(to_plain(value), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def write_json(path: Path, value: Any) -> None:
    """Write ``value`` as JSON, atomically."""
    write_text(path, to_json(value))


def read_json(path: Path) -> Any:
    """Parse a JSON file; InputError with line and column if it is invalid."""
    try:
        return json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise InputError(
            f"{path}: not JSON (line {error.lineno}, column {error.colno}: {error.msg})"
        ) from error
