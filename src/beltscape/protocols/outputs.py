"""Outputs to an I/O module by Modbus TCP: pulses and 4 to 20 mA, for control systems without a protocol.

A thread keeps the outputs of the module up to date until it is closed. Currents have the limits of NAMUR NE 43.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from math import isfinite
from pathlib import Path
from threading import Event
from time import monotonic
from typing import Any

from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException

from beltscape.core.errors import OutputError
from beltscape.core.supervision import make_supervised_thread
from beltscape.protocols.output_pulses import PulseOutput, PulseTarget, make_pulse_output, read_steps
from beltscape.protocols.plant import Plant, PlantState
from beltscape.protocols.settings import AnalogueSettings, OutputQuantity, OutputSettings

_TIMEOUT_S = 1.0
"""Time for an answer; a module of a plant's network answers within some ms."""


class ModuleAwayError(Exception):
    """The module does not answer, or refuses a request."""


class OutputModule:
    """Writes to the module and reads back; every method raises ModuleAwayError where that fails."""

    def __init__(self, settings: OutputSettings) -> None:
        self._settings = settings
        self._client: Any = None
        logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # it would log every failure to connect

    def write_coil(self, address: int, *, is_on: bool) -> None:
        """Switch a coil; done again it changes nothing."""
        self._ask("write_coil", address, is_on)

    def read_coil(self, address: int) -> bool:
        """Return whether a coil is on."""
        return bool(self._ask("read_coils", address, count=1).bits[0])

    def write_registers(self, address: int, words: list[int]) -> None:
        """Write holding registers in one request."""
        self._ask("write_registers", address, words)

    def close(self) -> None:
        """Close the connection; the next request opens a new one."""
        if self._client is not None:
            self._client.close()
            self._client = None

    def _ask(self, request: str, address: int, *values: Any, **more: Any) -> Any:
        """Return the answer to a request."""
        place = f"{self._settings.host} port {self._settings.port}"
        try:
            if self._client is None:
                client: Any = ModbusTcpClient(
                    self._settings.host, port=self._settings.port, timeout=_TIMEOUT_S, retries=0
                )
                if not client.connect():
                    raise ModuleAwayError(f"{place}: cannot be connected")
                self._client = client
            answer = getattr(self._client, request)(address, *values, device_id=self._settings.unit, **more)
        except (ModbusException, OSError) as error:
            self.close()
            raise ModuleAwayError(f"{place}: {' '.join(str(error).split())}") from error
        if answer.isError():
            raise ModuleAwayError(f"{place}: refuses {request} at address {address} ({answer})")
        return answer


_LOW_MA, _HIGH_MA = 3.8, 20.5
"""Limits of a measured value; beyond its scale it stays at them (NAMUR NE 43)."""
FAILURE_MA = {"low": 3.5, "high": 21.5}
"""Currents of a failure: at most 3.6 mA or at least 21 mA (NAMUR NE 43)."""
_READ: Mapping[OutputQuantity, Callable[[PlantState], float]] = {
    "flow_t_h": lambda state: state.mass_flow_t_h,
    "flow_m3_h": lambda state: state.volume_flow_m3_h,
    "load_m2": lambda state: state.area_mm2 * 1e-6,
    "coverage": lambda state: state.coverage,
    "speed_m_s": lambda state: state.speed_m_s,
}


def compute_current_ma(settings: AnalogueSettings, state: PlantState) -> float:
    """Return the current of an output; that of a failure where the value is not known or nothing is measured."""
    value = _READ[settings.value](state)
    if not isfinite(value) or (state.standing == "missing" and settings.value != "speed_m_s"):
        return FAILURE_MA[settings.failure]
    share = (value - settings.zero) / (settings.full - settings.zero)
    return min(max(4.0 + 16.0 * share, _LOW_MA), _HIGH_MA)


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
