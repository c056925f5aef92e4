"""The pulse count: how many times a given mass or volume has passed since the ledger began."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from beltscape.protocols.kept_number import KeptNumber


class PulseCount:
    """A count that never falls, over restarts too; it is written before it is shown.

    The ledger's total falls a little where an empty belt reads below zero; a pulse that was given is not taken back,
    and the next comes when the total exceeds its highest value.
    """

    def __init__(self, path: Path, step: float, on_message: Callable[[str], object] = lambda _: None) -> None:
        """Read the count that was given last; ``step`` is the mass or volume of a pulse."""
        self._step = step
        instead = "the count is taken from the ledger's total"
        self._kept = KeptNumber(path, "beltscape-pulses/1", "count", ("step", step), instead, on_message)

    @property
    def count(self) -> int:
        """Return the pulses that were given."""
        return self._kept.number or 0

    def update(self, total: float) -> int:
        """Return the count for a total; OutputError if it cannot be kept. NaN changes nothing."""
        if math.isfinite(total) and (count := math.floor(total / self._step + 1e-9)) > self.count:
            self._kept.keep(count)
        return self.count
