"""The encoder's offset in encoder.json, which is added to its count and kept over restarts of the program."""

from __future__ import annotations

import json
import math
from pathlib import Path

from beltscape.core.errors import OutputError
from beltscape.files.folders.durable import keep_state, read_state
from beltscape.sources.encoder.settings import EncoderSettings

FORMAT = "beltscape-encoder/1"


class EncoderOffset:
    """The stored offset of one encoder; a damaged file, and one of another encoder, counts as none."""

    def __init__(self, path: Path, settings: EncoderSettings) -> None:
        self._path = path
        self.trouble = ""
        """Why a stored offset is not known, in one line; empty: it is, or there was none."""
        self._identity = {
            "format": FORMAT,
            "kind": settings.kind,
            "mm_per_count": settings.mm_per_count,
            "counter_bits": settings.counter_bits,
            "reverse": settings.reverse,
        }

    def read_mm(self) -> float:
        """Return the offset; 0 without a stored one. A damaged file is set aside, see ``trouble``."""
        instead = "without the offset positions go on at the ledger's end"
        offset_mm, self.trouble = read_state(self._path, self._parse, instead)
        return offset_mm or 0.0

    def _parse(self, data: bytes) -> float:
        document = json.loads(data)
        offset_mm = document["offset_mm"]
        if type(offset_mm) not in (int, float) or not math.isfinite(offset_mm):
            raise ValueError("offset_mm")
        is_same = {key: document[key] for key in self._identity} == self._identity
        return float(offset_mm) if is_same else 0.0

    def write_mm(self, offset_mm: float) -> str:
        """Store the offset; return the reason of a failure in one line, or an empty text."""
        try:
            keep_state(self._path, (json.dumps({**self._identity, "offset_mm": offset_mm}) + "\n").encode())
        except OutputError as error:
            return str(error)
        return ""
