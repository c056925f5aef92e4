"""encoder.json: what must be added to the encoder's own count, kept over restarts of the program."""

from __future__ import annotations

import json
from pathlib import Path

from beltscape.core.errors import OutputError
from beltscape.files.atomic import write_text
from beltscape.sources.encoder.settings import EncoderSettings

FORMAT = "beltscape-encoder/1"


class Origin:
    """The offset of one encoder; a file of another encoder, or one that cannot be read, counts as none."""

    def __init__(self, path: Path, settings: EncoderSettings) -> None:
        self._path = path
        self._whose = {
            "format": FORMAT,
            "kind": settings.kind,
            "mm_per_count": settings.mm_per_count,
            "counter_bits": settings.counter_bits,
            "reverse": settings.reverse,
        }

    def read_mm(self) -> float:
        """The offset; 0 where none was ever needed."""
        try:
            document = json.loads(self._path.read_text(encoding="utf-8"))
            if {key: document[key] for key in self._whose} == self._whose:
                return float(document["offset_mm"])
        except (OSError, ValueError, KeyError, TypeError):
            pass  # without it positions start at the ledger's end
        return 0.0

    def write_mm(self, offset_mm: float) -> str:
        """Keep it; what hindered that, in one line, or nothing."""
        try:
            write_text(self._path, json.dumps({**self._whose, "offset_mm": offset_mm}) + "\n")
        except OutputError as error:
            return str(error)
        return ""
