"""The number of pulses that are due since outputs began: one per mass or volume that has passed."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from beltscape.protocols.kept_number import KeptNumber
from beltscape.protocols.outputs.settings import PulseSettings
from beltscape.protocols.plant import PlantState

_KEEP_RECORDS = 500
"""Records after which the ledger's end is kept anew; it only serves to find that a ledger was replaced. Chosen."""


class PulseTarget:
    """The count of due pulses; it never falls, over restarts and a replaced ledger too."""

    def __init__(
        self, settings: PulseSettings, data: Path, on_message: Callable[[str], object] = lambda _: None
    ) -> None:
        """Read what was kept; a damaged file is set aside with a message."""
        self._settings = settings
        self._step = settings.kg or settings.l or math.inf
        key = ("step", f"{self._step} {'kg' if settings.kg else 'l'}")
        self._base = KeptNumber(
            data / "outputs_base.json",
            "beltscape-pulse-base/1",
            "base",
            key,
            "pulses go on from the present total, and those that waited are not given",
            on_message,
            least=-(1 << 62),
        )
        self._record = KeptNumber(
            data / "outputs_record.json",
            "beltscape-pulse-record/1",
            "record",
            key,
            "a ledger that was replaced meanwhile is not noticed",
            on_message,
        )
        self._due = 0

    @property
    def key(self) -> tuple[str, str | float]:
        """Return what the given pulses belong to: the size of a pulse."""
        return "step", f"{self._step} {'kg' if self._settings.kg else 'l'}"

    def find_given(self, state: PlantState) -> int | None:
        """Return the pulses that must have been given up to now, where their count is lost; None: not known yet."""
        passed, base = self._count_passed(state), self._base.number
        if passed is None:
            return None
        return 0 if base is None else max(0, base + passed)

    def update(self, state: PlantState, given: int) -> tuple[int, bool]:
        """Return the due pulses, and whether the ledger was found to be replaced.

        ``given``: the pulses that were given. OutputError if a number cannot be kept.
        """
        passed = self._count_passed(state)
        if passed is None:
            return max(self._due, given), False
        known = self._record.number
        is_replaced = known is not None and state.record < known
        if self._base.number is None or is_replaced:
            self._base.keep(given - passed)
        if known is None or is_replaced or state.record >= known + _KEEP_RECORDS:
            self._record.keep(state.record)
        # where an empty belt reads below zero the total falls a little: pulses that are due stay due
        self._due = max(self._due, given, (self._base.number or 0) + passed)
        return self._due, is_replaced

    def _count_passed(self, state: PlantState) -> int | None:
        """Return the pulses of the ledger's total; None where it is not known."""
        totals = state.totals
        total = totals.mass_kg if self._settings.kg is not None else totals.volume_mm3 * 1e-6
        return math.floor(total / self._step + 1e-9) if math.isfinite(total) else None
