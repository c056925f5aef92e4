"""A number that a protocol keeps on the disk over restarts, such as the last record that was acknowledged."""

from __future__ import annotations

import json
from pathlib import Path

from beltscape.core.errors import InputError
from beltscape.files.folders.atomic import write_text


class KeptNumber:
    """A whole number in a file of its own; it is written before it counts.

    It belongs to a ``key``, such as the broker or the size of a pulse: the number of another key is not used.
    """

    def __init__(
        self, path: Path, file_format: str, name: str, key: tuple[str, str | float], fix: str
    ) -> None:
        """Read the number; ``name`` is its name in the file, ``key`` the name and value of what it belongs to.

        Raises
        ------
        InputError
            If the file is damaged; ``fix`` says what removing it leads to.
        """
        self._path, self._format, self._name, self._key = path, file_format, name, key
        self.number = self._read(fix)
        """The kept number; None: none was kept for this key."""

    def keep(self, number: int) -> None:
        """Keep a number; OutputError if it cannot be written."""
        document = {"format": self._format, self._key[0]: self._key[1], self._name: number}
        write_text(self._path, json.dumps(document) + "\n")
        self.number = number

    def _read(self, fix: str) -> int | None:
        if not self._path.is_file():
            return None
        try:
            document = json.loads(self._path.read_text("utf-8"))
            known, number = document[self._key[0]], int(document[self._name])
        except (ValueError, KeyError, TypeError, OSError) as error:
            raise InputError(f"{self._path}: cannot be read ({error}); remove it to {fix}") from error
        return number if known == self._key[1] else None
