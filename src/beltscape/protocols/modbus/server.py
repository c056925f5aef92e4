"""The server: answers reads of holding and input registers (functions 3 and 4) from one reading of the state.

Every request is answered from one reading, so that the words of a value, and values that are read together, belong
together. A connection's requests are answered in their order, each with its own transaction number, however the
network has cut or joined them. Writes are refused unless the settings have a table of commands.
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from time import monotonic

from beltscape.core.errors import OutputError
from beltscape.core.runtime.supervision import describe_failure
from beltscape.protocols.listening import ListeningThread
from beltscape.protocols.modbus.commands import Commands, place_commands
from beltscape.protocols.modbus.pulses import PulseCount
from beltscape.protocols.modbus.registers import Reading, place_registers
from beltscape.protocols.modbus.settings import ModbusSettings
from beltscape.protocols.plant import Plant, PlantCommands, PlantUsers

_READS, _WRITE_ONE, _WRITE_SEVERAL = (3, 4), 6, 16
"""Functions that are answered: reads of holding and input registers, writes of one and of several registers."""
_HEADER = struct.Struct(">HHHB")
"""Transaction, protocol (0), bytes that follow, unit (Modbus Messaging on TCP/IP V1.0b, section 3.1.3)."""
_MOST_BYTES = 254
"""Most bytes after the length: the unit, and 253 of function and data (Modbus Application Protocol V1.1b3, 4.1)."""
_MOST_READ, _MOST_WRITTEN = 125, 123
"""Most registers of a request (the same, 6.3 and 6.12)."""
_ILLEGAL_FUNCTION, _ILLEGAL_ADDRESS, _ILLEGAL_VALUE, _DEVICE_FAILURE, _NO_SUCH_UNIT = 1, 2, 3, 4, 11
"""Exception codes (the same, section 7)."""
_MOST_CLIENTS = 64
"""Connections at once; a further one closes the one that was silent longest, as Modbus Messaging on TCP/IP asks."""
_START_S = 10.0
"""Time for the server to listen."""
_POLL_S = 0.5
"""Interval at which the pulse count is kept, and the end is looked for."""


class _RefusedError(Exception):
    """A request is answered with an exception code, its only argument."""


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
        self._clients: dict[asyncio.StreamWriter, float] = {}
        self._failure = ""
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
        try:
            server = await asyncio.start_server(self._serve_client, self._settings.host, self._settings.port)
        except OSError as error:
            self._listening.fail(error)
            return
        self.port = server.sockets[0].getsockname()[1]
        self._listening.confirm()
        while not self._listening.is_stopped:
            if self._pulses is not None:
                self.read()
            await asyncio.sleep(_POLL_S)
        server.close()

    async def _serve_client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer the requests of a connection until it ends, or until it is none of Modbus."""
        self._clients[writer] = monotonic()
        while len(self._clients) > _MOST_CLIENTS:
            silent = min(self._clients, key=self._clients.__getitem__)
            del self._clients[silent]
            silent.close()
        try:
            while True:
                header = await reader.readexactly(_HEADER.size)
                transaction, protocol, size, unit = _HEADER.unpack(header)
                if protocol or not 1 < size <= _MOST_BYTES:
                    return  # where the next request would begin is not known
                answer = await self._answer(unit, await reader.readexactly(size - 1))
                self._clients[writer] = monotonic()
                writer.write(_HEADER.pack(transaction, 0, len(answer) + 1, unit) + answer)
                await writer.drain()
        except (asyncio.IncompleteReadError, OSError):
            return
        finally:
            self._clients.pop(writer, None)
            writer.close()

    async def _answer(self, unit: int, request: bytes) -> bytes:
        """Return the answer to a request, function and data, or its exception."""
        function = request[0]
        try:
            if unit != self._settings.unit and self._settings.unit:
                raise _RefusedError(_NO_SUCH_UNIT)
            if function in _READS:
                return self._answer_read(request)
            if function in (_WRITE_ONE, _WRITE_SEVERAL) and self._commands is not None:
                return await self._answer_write(self._commands, request)
            raise _RefusedError(_ILLEGAL_FUNCTION)
        except _RefusedError as error:
            code = error.args[0]
        except Exception as error:
            code, failure = _DEVICE_FAILURE, f"modbus: {describe_failure(error)}; a request was not answered"
            if failure != self._failure:
                self._on_message(failure)
            self._failure = failure
        return bytes((function | 0x80, code))

    def _answer_read(self, request: bytes) -> bytes:
        if len(request) != 5:
            raise _RefusedError(_ILLEGAL_VALUE)
        function, address, count = struct.unpack(">BHH", request)
        if not 1 <= count <= _MOST_READ:
            raise _RefusedError(_ILLEGAL_VALUE)
        words = self._read_words()
        try:
            wanted = [words[address + i] for i in range(count)]
        except KeyError as error:
            raise _RefusedError(_ILLEGAL_ADDRESS) from error
        return struct.pack(f">BB{count}H", function, 2 * count, *wanted)

    def _read_words(self) -> dict[int, int]:
        """Return the words by their addresses, all of one reading."""
        reading, words = self.read(), dict[int, int]()
        for register in self._registers:
            words.update(enumerate(register.pack(reading, self._settings), register.address))
        if self._commands is not None:
            words.update(enumerate(self._commands.words, self._written[0].address))
        return words

    async def _answer_write(self, commands: Commands, request: bytes) -> bytes:
        """Take a write of commands, in a thread: what it changes is on the disk before the answer."""
        address, values = _parse_write(request)
        if not commands.covers(address, len(values)):
            raise _RefusedError(_ILLEGAL_ADDRESS)
        try:
            await asyncio.to_thread(commands.write, address, values)
        except OutputError as error:
            self._on_message(f"modbus: {error}; the command was not taken")
            raise _RefusedError(_DEVICE_FAILURE) from error
        return request[:5]


def _parse_write(request: bytes) -> tuple[int, Sequence[int]]:
    """Return the first address and the values of a write of one or of several registers."""
    if request[0] == _WRITE_ONE and len(request) == 5:
        _, address, value = struct.unpack(">BHH", request)
        return address, (value,)
    if request[0] == _WRITE_SEVERAL and len(request) > 6:
        _, address, count, size = struct.unpack(">BHHB", request[:6])
        if 1 <= count <= _MOST_WRITTEN and size == 2 * count and len(request) == 6 + size:
            return address, struct.unpack(f">{count}H", request[6:])
    raise _RefusedError(_ILLEGAL_VALUE)
