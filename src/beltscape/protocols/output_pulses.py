"""Pulses as a coil or as a counter: each exactly once, over restarts, kills and lost connections.

One pulse is due per mass or volume that has passed since outputs began. The counter is the count itself, so that
writing it again changes nothing.

A coil is switched on for each pulse and off behind it, and the file keeps how far this has come: 2 n while n pulses
are complete, 2 n + 1 while the coil is on for the next one. It is written after the module has confirmed the change,
and the coil tells after a crash or a lost answer whether the change before it was made: an "on" that was not kept
still is on. So each pulse has one rising edge, as long as the module holds its coil and carries out requests in their
order. A module that loses its supply, or whose watchdog switches the coil off, within the milliseconds between "on"
and its entry in the file gives this one pulse again: at least once is chosen there, since a counter that lacks
material cannot be made up for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from time import monotonic
from typing import Protocol

from beltscape.protocols.kept_number import KeptNumber
from beltscape.protocols.plant import PlantState
from beltscape.protocols.settings import PulseSettings


class IoModule(Protocol):
    """The I/O module."""

    def write_coil(self, address: int, *, is_on: bool) -> None:
        """Switch a coil."""
        ...

    def read_coil(self, address: int) -> bool:
        """Return whether a coil is on."""
        ...

    def write_registers(self, address: int, words: list[int]) -> None:
        """Write holding registers."""
        ...


class PulseOutput(Protocol):
    """An output that gives pulses."""

    @property
    def given(self) -> int:
        """Return the pulses that were given."""
        ...

    @property
    def is_lost(self) -> bool:
        """Return whether the kept count was damaged: nothing is given before `restore`."""
        ...

    def restore(self, given: int) -> None:
        """Go on from a number of given pulses that was found otherwise; OutputError if it cannot be kept."""
        ...

    def advance(self, module: IoModule, due: int) -> float | None:
        """Go on towards the due pulses; return the seconds until the next step, or None if there is none."""
        ...

    def forget(self) -> None:
        """Take nothing of the module's state for granted, since the connection was lost."""
        ...


class CounterOutput:
    """Two registers with the number of due pulses."""

    def __init__(self, settings: PulseSettings, kept: KeptNumber) -> None:
        """``kept`` is twice the number of pulses."""
        self._address, self._kept = settings.address, kept

    @property
    def given(self) -> int:
        """Return the pulses that were given."""
        return (self._kept.number or 0) // 2

    @property
    def is_lost(self) -> bool:
        """Return whether the kept count was damaged and is not restored yet."""
        return self._kept.is_lost and self._kept.number is None

    def restore(self, given: int) -> None:
        """Go on from a number of given pulses."""
        self._kept.keep(2 * given)

    def advance(self, module: IoModule, due: int) -> float | None:
        """Write the count; the module gets it again with every call, so that it has it after its own restart too."""
        if due > self.given or self._kept.number is None:
            self._kept.keep(2 * due)  # before it is shown, so that it never falls
        count = self.given % (1 << 32)
        module.write_registers(self._address, [count >> 16, count & 0xFFFF])
        return None

    def forget(self) -> None:
        """Keep nothing: every call writes the whole count."""


class CoilOutput:
    """A coil with one rising edge for every pulse."""

    def __init__(
        self, settings: PulseSettings, kept: KeptNumber, clock: Callable[[], float] = monotonic
    ) -> None:
        """``kept`` says how far the pulses have come."""
        self._settings, self._kept, self._clock = settings, kept, clock
        self._restored: int | None = None
        """Steps that were found otherwise, until the coil is off."""
        self._is_certain = False
        self._wait_until_s = 0.0

    @property
    def given(self) -> int:
        """Return the pulses that were begun."""
        return ((self._kept.number or 0) + 1) // 2

    @property
    def is_lost(self) -> bool:
        """Return whether the kept count was damaged and is not restored yet."""
        return self._kept.is_lost and self._kept.number is None and self._restored is None

    def restore(self, given: int) -> None:
        """Go on from a number of given pulses; a coil that is on belongs to the last of them."""
        self._restored = 2 * given

    def advance(self, module: IoModule, due: int) -> float | None:
        """Switch the coil if it is time to; see ``PulseOutput.advance``."""
        if not self._is_certain:
            self._make_certain(module)
        steps = self._kept.number or 0
        is_on = steps % 2 == 1
        if not is_on and self.given >= due:
            return None
        wait_s = self._wait_until_s - self._clock()
        if wait_s > 0:
            return wait_s
        self._is_certain = False  # until the answer is here
        module.write_coil(self._settings.address, is_on=not is_on)
        self._keep(steps + 1)
        self._is_certain = True
        return self._wait_until_s - self._clock()

    def forget(self) -> None:
        """Read the coil before the next step."""
        self._is_certain = False

    def _make_certain(self, module: IoModule) -> None:
        """Find out whether the last change was made though it was not kept."""
        steps = self._kept.number
        if steps is None:  # a coil that was on before the first pulse belongs to none
            module.write_coil(self._settings.address, is_on=False)
            self._keep(self._restored or 0)
        else:
            was_made = module.read_coil(self._settings.address) != (steps % 2 == 1)
            self._keep(steps + was_made)
        self._is_certain = True

    def _keep(self, steps: int) -> None:
        if steps != self._kept.number:
            self._kept.keep(steps)
        wait_ms = self._settings.on_ms if steps % 2 else self._settings.off_ms
        self._wait_until_s = self._clock() + wait_ms / 1000


def read_steps(data: Path, key: tuple[str, str | float], on_message: Callable[[str], object]) -> KeptNumber:
    """Return twice the number of given pulses, and one more while a coil is on, as kept in the folder ``data``."""
    instead = "the given pulses are counted by the ledger's total, and those that waited are not given"
    path = data / "outputs_pulses.json"
    return KeptNumber(path, "beltscape-pulse-steps/1", "steps", key, instead, on_message)


def make_pulse_output(settings: PulseSettings, kept: KeptNumber) -> PulseOutput:
    """Return the output of the settings, which goes on from what was kept."""
    return (CounterOutput if settings.kind == "counter" else CoilOutput)(settings, kept)


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
