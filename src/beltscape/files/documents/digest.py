"""SHA-256 digests in JSON documents: changed bytes are recognised when the document is read."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any

from beltscape.core.errors import InputError
from beltscape.files.documents.json_text import to_plain

KEY = "sha256"
"""Key of the digest in its document."""
_SIMILAR = 0.6
"""Similarity (difflib) of a damaged key to that of the digest; the documents' other keys stay below."""


def add_digest(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the document with the digest of its other keys as its last key."""
    others = {key: value for key, value in document.items() if key != KEY}
    return {**others, KEY: _compute_digest(others)}


def require_digest(path: Path, document: Mapping[str, Any], fix: str) -> None:
    """Raise InputError if the document's digest contradicts its content; a document without one is accepted."""
    if KEY in document:
        others = {key: value for key, value in document.items() if key != KEY}
        is_sound = document[KEY] == _compute_digest(others)
    else:
        is_sound = all(SequenceMatcher(None, key, KEY).ratio() < _SIMILAR for key in document)
    if not is_sound:
        raise InputError(
            f"{path}: its content contradicts its {KEY}: the file was changed or damaged after it was written; {fix}"
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
