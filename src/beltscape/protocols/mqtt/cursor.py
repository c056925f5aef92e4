"""The number of the last record that the broker has acknowledged, kept on the disk."""

from __future__ import annotations

import json
from pathlib import Path

from beltscape.core.errors import InputError
from beltscape.files.folders.atomic import write_text

_FORMAT = "beltscape-mqtt/1"


class Cursor:
    """A ledger number that survives a restart; it is written before it counts."""

    def __init__(self, path: Path, broker: str) -> None:
        """Read the cursor of a broker; another broker, or none yet, has no cursor.

        Raises
        ------
        InputError
            If the file is damaged.
        """
        self._path, self._broker = path, broker
        self.number = self._read()
        """The last acknowledged record; None: nothing was published to this broker yet."""

    def advance(self, number: int) -> None:
        """Keep a number; OutputError if it cannot be written."""
        document = {"format": _FORMAT, "broker": self._broker, "acknowledged": number}
        write_text(self._path, json.dumps(document) + "\n")
        self.number = number

    def _read(self) -> int | None:
        if not self._path.is_file():
            return None
        try:
            document = json.loads(self._path.read_text("utf-8"))
            known, number = document["broker"], int(document["acknowledged"])
        except (ValueError, KeyError, TypeError, OSError) as error:
            raise InputError(
                f"{self._path}: cannot be read ({error}); remove it to publish from the newest record on"
            ) from error
        return number if known == self._broker else None
