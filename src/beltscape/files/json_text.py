"""Reading and writing of JSON with stable key order and full float precision; NaN becomes null.

A document may hold the SHA-256 of its content, by which changed bytes are recognised when it is read.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.checks import is_list_or_tuple, is_mapping
from beltscape.core.errors import InputError
from beltscape.files.atomic import write_text
from beltscape.files.paths import read_text

_LARGEST = float(np.finfo(np.float64).max)
"""Largest number of a double; a JSON document may hold longer ones, and comparison with it excludes NaN, too."""


_PLAIN = frozenset({str, int, bool, type(None)})
"""Types of values that JSON has."""


def to_plain(value: Any) -> Any:
    """Convert arrays, NumPy scalars, tuples, paths and NaN to types of JSON."""
    kind = type(value)
    if kind is float:  # most values of a document, and the other questions take ten times as long
        return value if math.isfinite(value) else None
    if kind in _PLAIN:
        return value
    if is_mapping(value):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        is_finite = value.dtype.kind == "f" and np.isfinite(value).all()
        return value.tolist() if is_finite else to_plain(value.tolist())
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


DIGEST_KEY = "sha256"
"""Key of the digest in its document."""
_SIMILAR = 0.6
"""Similarity (difflib) of a damaged key to that of the digest; the documents' other keys stay below."""


def add_digest(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the document with the digest of its other keys as its last key."""
    others = {key: value for key, value in document.items() if key != DIGEST_KEY}
    return {**others, DIGEST_KEY: _compute_digest(others)}


def require_digest(path: Path, document: Mapping[str, Any], fix: str = "") -> None:
    """Raise InputError if the document's digest contradicts its content; a document without one is accepted.

    The line ends with ``fix``; where it is empty, the caller says what happens.
    """
    if DIGEST_KEY in document:
        others = {key: value for key, value in document.items() if key != DIGEST_KEY}
        is_sound = document[DIGEST_KEY] == _compute_digest(others)
    else:
        is_sound = all(SequenceMatcher(None, key, DIGEST_KEY).ratio() < _SIMILAR for key in document)
    if not is_sound:
        raise InputError(
            f"{path}: its content contradicts its {DIGEST_KEY}: the file was changed or damaged after it was "
            f"written{f'; {fix}' if fix else ''}"
        )


def compute_file_digests(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """Return the digests of those of the files, relative to ``folder``, that exist."""
    return {name: hash_file(folder / name) for name in names if (folder / name).is_file()}


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file; OSError if it cannot be read."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _compute_digest(document: Mapping[str, Any]) -> str:
    """Return the digest of a document's values, whatever the layout of its text."""
    text = json.dumps(to_plain(document), sort_keys=True, ensure_ascii=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()
