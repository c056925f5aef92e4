"""The encoder's offset in encoder.json, which is added to its count and kept over restarts of the program."""

from __future__ import annotations

import json
from pathlib import Path

from beltscape.core.errors import OutputError
from beltscape.files.folders.atomic import write_text
from beltscape.sources.encoder.settings import EncoderSettings

FORMAT = "beltscape-encoder/1"


class EncoderOffset:
    """The stored offset of one encoder; a file that is unreadable or of another encoder counts as none."""

    def __init__(self, path: Path, settings: EncoderSettings) -> None:
        self._path = path
        self._identity = {
            "format": FORMAT,
            "kind": settings.kind,
            "mm_per_count": settings.mm_per_count,
            "counter_bits": settings.counter_bits,
            "reverse": settings.reverse,
        }

    def read_mm(self) -> float:
        """Return the offset; 0 without a stored one."""
        try:
            document = json.loads(self._path.read_text(encoding="utf-8"))
            if {key: document[key] for key in self._identity} == self._identity:
                return float(document["offset_mm"])
        except (OSError, ValueError, KeyError, TypeError):
            pass  # without an offset positions start at the ledger's end
        return 0.0

    def write_mm(self, offset_mm: float) -> str:
        """Store the offset; return the reason of a failure in one line, or an empty text."""
        try:
            write_text(self._path, json.dumps({**self._identity, "offset_mm": offset_mm}) + "\n")
        except OutputError as error:
            return str(error)
        return ""
