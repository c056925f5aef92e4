"""The writer: a thread that keeps the outputs of an I/O module up to date until it is closed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from threading import Event
from time import monotonic

from beltscape.core.errors import OutputError
from beltscape.core.runtime.supervision import make_supervised_thread
from beltscape.protocols.outputs.analogue import FAILURE_MA, compute_current_ma
from beltscape.protocols.outputs.module import ModuleAwayError, OutputModule
from beltscape.protocols.outputs.pulse_target import PulseTarget
from beltscape.protocols.outputs.pulses import PulseOutput, make_pulse_output, read_steps
from beltscape.protocols.outputs.settings import OutputSettings
from beltscape.protocols.plant import Plant, PlantState

_PAUSE_S = 0.5
"""Pause after a failure: a module's own restart takes seconds."""
_MANY = 100
"""Pulses that wait before a message says that the output is too slow, or the module away."""


class OutputWriter:
    """Writes a plant's outputs to a module."""

    def __init__(
        self,
        settings: OutputSettings,
        plant: Plant,
        data: Path,
        on_message: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Prepare; ``data`` is the folder of the pulses' count."""
        self._settings, self._plant, self._on_message = settings, plant, on_message
        self._module, self._stop = OutputModule(settings), Event()
        self._target: PulseTarget | None = None
        self._pulses: PulseOutput | None = None
        if settings.pulse is not None:
            self._target = PulseTarget(settings.pulse, data, on_message)
            kept = read_steps(data, self._target.key, on_message)
            self._pulses = make_pulse_output(settings.pulse, kept)
        self._due = self._beats = 0
        self._trouble, self._is_late = "", False
        self._thread = make_supervised_thread("outputs", self._run, on_message, self._stop.wait)

    def start(self) -> None:
        """Start writing; returns at once."""
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Return the pulses that are due and not given yet."""
        return 0 if self._pulses is None else max(0, self._due - self._pulses.given)

    def close(self, patience_s: float = 3.0) -> None:
        """Complete the pulse that is on, and end; analogue outputs show a failure."""
        self._stop.set()
        self._thread.join(patience_s)

    def _run(self) -> None:
        next_s = 0.0
        while not self._stop.is_set():
            try:
                if monotonic() >= next_s:
                    next_s = monotonic() + self._settings.every_s
                    self._update(self._plant.read_state())
                wait_s = self._advance_pulses(self._due)
                self._set_trouble("")
            except (ModuleAwayError, OutputError) as error:
                self._forget()
                self._set_trouble(str(error))
                self._stop.wait(_PAUSE_S)
                continue
            left_s = max(next_s - monotonic(), 0.001)
            self._stop.wait(left_s if wait_s is None else min(max(wait_s, 0.0), left_s))
        self._finish()

    def _update(self, state: PlantState) -> None:
        """Write the analogue outputs, and find out how many pulses are due."""
        if self._target is not None and self._pulses is not None:
            given = self._target.find_given(state) if self._pulses.is_lost else None
            if given is not None:
                self._pulses.restore(given)
            self._due, is_replaced = self._target.update(state, self._pulses.given)
            if is_replaced:
                self._on_message("outputs: the ledger was replaced; pulses go on with its present total")
            self._note_backlog()
        for output in self._settings.analogue:
            word = output.convert(compute_current_ma(output, state))
            self._module.write_registers(output.address, [word])
        if self._settings.heartbeat is not None:
            self._beats = (self._beats + 1) % (1 << 16)
            self._module.write_registers(self._settings.heartbeat, [self._beats])

    def _advance_pulses(self, due: int) -> float | None:
        """Go on towards the due pulses; return the seconds until the next step, None if there is none."""
        if self._pulses is None or self._pulses.is_lost:
            return None
        return self._pulses.advance(self._module, due)

    def _note_backlog(self) -> None:
        is_late = self.waiting > _MANY
        if is_late and not self._is_late:
            self._on_message(
                f"outputs: {self.waiting} pulses wait; they are given as fast as on_ms and off_ms allow"
            )
        self._is_late = is_late

    def _finish(self) -> None:
        """Complete the pulse that is on, and show a failure at the analogue outputs."""
        try:
            given = 0 if self._pulses is None else self._pulses.given
            while (wait_s := self._advance_pulses(given)) is not None:
                Event().wait(min(wait_s, 1.0))
            for output in self._settings.analogue:
                self._module.write_registers(output.address, [output.convert(FAILURE_MA[output.failure])])
        except (ModuleAwayError, OutputError):
            pass  # the module's own watchdog shows it
        self._module.close()

    def _forget(self) -> None:
        self._module.close()
        if self._pulses is not None:
            self._pulses.forget()

    def _set_trouble(self, trouble: str) -> None:
        if trouble != self._trouble:
            self._on_message(f"outputs: {trouble or 'the module answers'}")
        self._trouble = trouble
