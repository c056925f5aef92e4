"""Damage of small files of state, as kills, full disks and people leave it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

DAMAGES = {
    "empty": b"",
    "cut": b'{"format": "belts',
    "zeros": bytes(4096),
    "not text": b"\xff\xfe\x00",
    "no object": b"[1, 2]",
    "null": b"null",
    "no keys": b"{}",
    "nested": b"[" * 100_000,
    "other": b'{"format": "something-else/1", "number": 3}',
}
"""What such a file may hold instead of a document of JSON, by a name for it."""


def damage_values(path: Path) -> dict[str, bytes]:
    """Return the document of a file with each of its numbers replaced by what is none, or none that can be."""
    import json

    document = json.loads(path.read_text())
    found: dict[str, bytes] = {}
    for key, value in document.items():
        if isinstance(value, int | float) and not isinstance(value, bool):
            for wrong in ("12", True, None, [3], 1e999, 0.5 if isinstance(value, int) else "x"):
                found[f"{key} = {wrong!r}"] = json.dumps({**document, key: wrong}).encode()
    return found


def check_set_aside(path: Path, data: bytes, read: Callable[[], list[str]]) -> None:
    """Damage a file, ``read`` it, and check that it is named in one line, moved away and not lost."""
    path.write_bytes(data)
    (message,) = read()
    assert message.startswith(f"{path}: ") and "\n" not in message and "moved to" in message, message
    assert not path.exists()
    kept = max((path.parent / "damaged").rglob(path.name), key=lambda one: one.stat().st_mtime_ns)
    assert kept.read_bytes() == data
