"""The server: answers reads of holding and input registers (functions 3 and 4) from one reading of the state.

Every request is answered from one reading, so that the words of a value, and values that are read together, belong
together. Writes are refused unless the settings have a table of commands.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Sequence
from pathlib import Path
from time import monotonic

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from beltscape.core.errors import OutputError
from beltscape.protocols.listening import ListeningThread
from beltscape.protocols.modbus.commands import Commands, place_commands
from beltscape.protocols.modbus.pulses import PulseCount
from beltscape.protocols.modbus.registers import Reading, place_registers
from beltscape.protocols.modbus.settings import ModbusSettings
from beltscape.protocols.plant import Plant, PlantCommands, PlantUsers

_READS, _WRITES = (3, 4), (6, 16)
"""Functions that are answered: reads of holding and input registers, writes of one and of several registers."""
_START_S = 10.0
"""Time for the server to listen."""
_POLL_S = 0.5
"""Interval at which the pulse count is kept, and the end is looked for."""


class ModbusServer:
    """Serves a plant's registers until it is closed."""

    def __init__(
        self,
        settings: ModbusSettings,
        plant: Plant,
        data: Path,
        on_message: Callable[[str], None] = lambda _: None,
        control: PlantCommands | None = None,
        users: PlantUsers | None = None,
    ) -> None:
        """Prepare; ``data`` is the folder of the pulse count.

        ``control`` carries out commands where the settings have their table; ``users`` logs them.

        Raises
        ------
        InputError
            If the map's addresses do not fit.
        """
        self._settings, self._plant, self._on_message = settings, plant, on_message
        self._registers = place_registers(settings)
        step = settings.pulse_kg or settings.pulse_l
        self._pulses = None if step is None else PulseCount(data / "pulses.json", step, on_message)
        self._written = place_commands(settings, self._registers)
        self._commands = None
        if settings.commands is not None and control is not None:
            self._commands = Commands(settings, plant, control, users, data, on_message)
        self._started_s = monotonic()
        self._listening = ListeningThread("modbus", self._serve, on_message, _START_S)
        self.port = settings.port
        """TCP port that is listened on, once it is."""

    def start(self) -> None:
        """Start listening.

        Raises
        ------
        InputError
            If the address is in use or not allowed.
        """
        # the library logs every malformed frame with its bytes, which would let anybody fill the log
        logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
        fix = "choose another port, or give the service the right to it"
        self._listening.start(self._settings.host, self._settings.port, fix)

    def close(self, patience_s: float = 5.0) -> None:
        """Stop listening."""
        self._listening.close(patience_s)

    def read(self) -> Reading:
        """Return what the registers are filled from now."""
        state, commands = self._plant.read_state(), self._commands
        done, result = (0, 0) if commands is None else (commands.done, commands.result)
        if self._pulses is None:
            return Reading(state, int(monotonic() - self._started_s), 0, done, result)
        totals = state.totals
        total = totals.mass_kg if self._settings.pulse_kg is not None else totals.volume_mm3 * 1e-6
        try:
            count = self._pulses.update(total)
        except OutputError as error:
            self._on_message(f"modbus: {error}; the pulse count waits")
            count = self._pulses.count
        return Reading(state, int(monotonic() - self._started_s), count, done, result)

    async def _serve(self) -> None:
        address = (self._settings.host, self._settings.port)
        server = ModbusTcpServer(self._make_device(), address=address)
        try:
            await server.serve_forever(background=True)
        except (RuntimeError, OSError) as error:
            self._listening.fail(error)
            return
        sockets = getattr(server.transport, "sockets", ())
        self.port = sockets[0].getsockname()[1] if sockets else self._settings.port
        self._listening.confirm()
        while not self._listening.is_stopped:
            if self._pulses is not None:
                self.read()
            await asyncio.sleep(_POLL_S)
        await server.shutdown()

    def _make_device(self) -> SimDevice:
        blocks = [
            SimData(register.address, count=register.words, datatype=DataType.REGISTERS, readonly=True)
            for register in self._registers
        ]
        if self._written:
            count = sum(register.words for register in self._written)
            blocks.append(SimData(self._written[0].address, count=count, datatype=DataType.REGISTERS))
            blocks.sort(key=lambda block: block.address)

        async def fill(
            function: int,
            start: int,
            address: int,
            _count: int,
            words: list[int],
            values: list[int] | list[bool] | None,
        ) -> ExcCodes | None:
            if values is not None:
                return await self._write(function, address, values)
            if function not in (*_READS, *_WRITES):  # pymodbus reads what function 6 has written
                return ExcCodes.ILLEGAL_FUNCTION
            reading = self.read()
            for register in self._registers:
                at = register.address - start
                words[at : at + register.words] = register.pack(reading, self._settings)
            return None

        return SimDevice(self._settings.unit, blocks, action=fill)

    async def _write(self, function: int, address: int, values: Sequence[int]) -> ExcCodes | None:
        """Take a write of commands, in a thread: what it changes is on the disk before the answer."""
        commands = self._commands
        if commands is None or function not in _WRITES:
            return ExcCodes.ILLEGAL_FUNCTION
        if not commands.covers(address, len(values)):
            return ExcCodes.ILLEGAL_ADDRESS
        try:
            await asyncio.to_thread(commands.write, address, values)
        except OutputError as error:
            self._on_message(f"modbus: {error}; the command was not taken")
            return ExcCodes.DEVICE_FAILURE
        return None
