"""Reading and writing of JSON with stable key order and full float precision; NaN becomes null."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.errors import InputError
from beltscape.core.type_guards import is_list_or_tuple, is_mapping
from beltscape.files.documents.plain_text import read_text
from beltscape.files.folders.atomic import write_text


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
