"""A number that a protocol keeps on the disk over restarts, such as the last record that was acknowledged."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from beltscape.files.atomic import keep_state, read_state


class KeptNumber:
    """A whole number in a file of its own; it is on the disk before it counts.

    It belongs to a ``key``, such as the broker or the size of a pulse: the number of another key is not used. A
    damaged file is set aside with a message, and its number found otherwise: it stops nobody.
    """

    def __init__(
        self,
        path: Path,
        file_format: str,
        name: str,
        key: tuple[str, str | float],
        instead: str,
        on_message: Callable[[str], object],
        least: int = 0,
    ) -> None:
        """Read the number; ``name`` is its name in the file, ``key`` the name and value of what it belongs to.

        ``instead`` ends the message about a damaged file: what is done without the number. A number below ``least``
        is damage.
        """
        self._path, self._format, self._name, self._key = path, file_format, name, key
        self._least = least
        found, trouble = read_state(path, self._parse, instead)
        self.is_lost = bool(trouble)
        """Whether the file was damaged: there may have been a number."""
        self.number = None if found is None or found[0] != key[1] else found[1]
        """The kept number; None: none was kept for this key."""
        if trouble:
            on_message(trouble)

    def keep(self, number: int) -> None:
        """Keep a number; OutputError if it cannot be written."""
        document = {"format": self._format, self._key[0]: self._key[1], self._name: number}
        keep_state(self._path, (json.dumps(document) + "\n").encode())
        self.number = number

    def _parse(self, data: bytes) -> tuple[object, int]:
        """Return key and number of the file; an exception of some kind if it is damaged."""
        document = json.loads(data)
        number = document[self._name]
        if document["format"] != self._format or type(number) is not int or number < self._least:
            raise ValueError(self._name)
        return document[self._key[0]], number
