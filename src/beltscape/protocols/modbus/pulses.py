"""The pulse count: how many times a given mass or volume has passed since the ledger began."""

from __future__ import annotations

import json
import math
from pathlib import Path

from beltscape.core.errors import InputError
from beltscape.files.folders.atomic import write_text

_FORMAT = "beltscape-pulses/1"


class PulseCount:
    """A count that never falls, over restarts too; it is written before it is shown.

    The ledger's total falls a little where an empty belt reads below zero; a pulse that was given is not taken back,
    and the next comes when the total exceeds its highest value.
    """

    def __init__(self, path: Path, step: float) -> None:
        """Read the count that was given last; ``step`` is the mass or volume of a pulse.

        Raises
        ------
        InputError
            If the file is damaged.
        """
        self._path, self._step = path, step
        self.count = self._read()
        """Pulses that were given."""

    def update(self, total: float) -> int:
        """Return the count for a total; OutputError if it cannot be kept. NaN changes nothing."""
        if math.isfinite(total) and (count := math.floor(total / self._step + 1e-9)) > self.count:
            document = {"format": _FORMAT, "step": self._step, "count": count}
            write_text(self._path, json.dumps(document) + "\n")
            self.count = count
        return self.count

    def _read(self) -> int:
        if not self._path.is_file():
            return 0
        try:
            document = json.loads(self._path.read_text("utf-8"))
            step, count = float(document["step"]), int(document["count"])
        except (ValueError, KeyError, TypeError, OSError) as error:
            raise InputError(f"{self._path}: cannot be read ({error}); remove it to count anew") from error
        return count if step == self._step else 0
