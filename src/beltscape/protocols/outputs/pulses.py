"""Pulses as a coil or as a counter: each exactly once, over restarts, kills and lost connections.

The counter is the count itself, so that writing it again changes nothing.

A coil is switched on for each pulse and off behind it, and the file keeps how far this has come: 2 n while n pulses
are complete, 2 n + 1 while the coil is on for the next one. It is written after the module has confirmed the change,
and the coil tells after a crash or a lost answer whether the change before it was made: an "on" that was not kept
still is on. So each pulse has one rising edge, as long as the module holds its coil and carries out requests in their
order. A module that loses its supply, or whose watchdog switches the coil off, within the milliseconds between "on"
and its entry in the file gives this one pulse again: at least once is chosen there, since a counter that lacks
material cannot be made up for.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import monotonic
from typing import Protocol

from beltscape.protocols.kept_number import KeptNumber
from beltscape.protocols.outputs.settings import PulseSettings


class Module(Protocol):
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

    def advance(self, module: Module, due: int) -> float | None:
        """Go on towards the due pulses; return the seconds until the next step, or None if there is none."""
        ...

    def forget(self) -> None:
        """Take nothing of the module's state for granted, since the connection was lost."""
        ...


class CounterOutput:
    """Two registers with the number of due pulses."""

    def __init__(self, settings: PulseSettings, data: Path, key: tuple[str, str | float]) -> None:
        """Read the count; InputError if the file is damaged."""
        self._address = settings.address
        self._kept = _read_kept(data, key)

    @property
    def given(self) -> int:
        """Return the pulses that were given."""
        return (self._kept.number or 0) // 2

    def advance(self, module: Module, due: int) -> float | None:
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
        self,
        settings: PulseSettings,
        data: Path,
        key: tuple[str, str | float],
        clock: Callable[[], float] = monotonic,
    ) -> None:
        """Read how many pulses were given; InputError if the file is damaged."""
        self._settings, self._clock = settings, clock
        self._kept = _read_kept(data, key)
        self._is_certain = False
        self._wait_until_s = 0.0

    @property
    def given(self) -> int:
        """Return the pulses that were begun."""
        return ((self._kept.number or 0) + 1) // 2

    def advance(self, module: Module, due: int) -> float | None:
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

    def _make_certain(self, module: Module) -> None:
        """Find out whether the last change was made though it was not kept."""
        steps = self._kept.number
        if steps is None:  # a coil that was on before the first pulse belongs to none
            module.write_coil(self._settings.address, is_on=False)
            self._keep(0)
        else:
            was_made = module.read_coil(self._settings.address) != (steps % 2 == 1)
            self._keep(steps + was_made)
        self._is_certain = True

    def _keep(self, steps: int) -> None:
        if steps != self._kept.number:
            self._kept.keep(steps)
        wait_ms = self._settings.on_ms if steps % 2 else self._settings.off_ms
        self._wait_until_s = self._clock() + wait_ms / 1000


def _read_kept(data: Path, key: tuple[str, str | float]) -> KeptNumber:
    return KeptNumber(data / "outputs_pulses.json", "beltscape-pulse-steps/1", "steps", key, "begin at 0")


def make_pulse_output(settings: PulseSettings, data: Path, key: tuple[str, str | float]) -> PulseOutput:
    """Return the output of the settings; InputError if the file of its count is damaged."""
    return (CounterOutput if settings.kind == "counter" else CoilOutput)(settings, data, key)
