"""Modbus TCP: the present state, totals and a pulse count as registers that a control system reads.

Every request is answered from one reading of the state (functions 3 and 4), so that the words of a value, and values
that are read together, belong together. A connection's requests are answered in their order, each with its own
transaction number, however the network has cut or joined them. The pulse count says how many times a given mass or
volume has passed since the ledger began; it survives restarts.

Writes are refused unless the settings have a table of commands. The control system then writes command, product and
name, and last a ``request`` that differs from ``command_done``; each command is carried out once, while the client's
heartbeat is seen. The request is kept before it is carried out, so a restart repeats none.
"""

from __future__ import annotations

import asyncio
import math
import struct
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from time import monotonic

from beltscape.core.errors import BeltscapeError, InputError, OutputError
from beltscape.core.supervision import describe_failure
from beltscape.protocols.kept_number import KeptNumber
from beltscape.protocols.listening import ListeningThread
from beltscape.protocols.modbus_registers import CommandRegister, Register, RegisterValues, place_registers
from beltscape.protocols.plant import Plant, PlantCommands, PlantUsers
from beltscape.protocols.settings import ModbusSettings

USER = "modbus"
"""Name under which its commands are logged: Modbus has no users."""
NAME_WORDS = 16
"""Registers of a name: 32 bytes."""
CHANGE_PRODUCT, START_BATCH, STOP_BATCH, ACKNOWLEDGE = 1, 2, 3, 4
"""Values of ``command``."""
DONE, REFUSED, NO_HEARTBEAT = 1, 2, 3
"""Values of ``command_result``."""
_ACTIONS = {
    CHANGE_PRODUCT: "change_product",
    START_BATCH: "start_batch",
    STOP_BATCH: "stop_batch",
    ACKNOWLEDGE: "acknowledge",
}


def place_commands(settings: ModbusSettings, placed: Sequence[Register]) -> tuple[CommandRegister, ...]:
    """Return the registers that are written; none where commands are off.

    Raises
    ------
    InputError
        If they overlap those that are read.
    """
    if settings.commands is None:
        return ()
    at = settings.commands.first
    registers = (
        CommandRegister("client_heartbeat", "uint16", 1, "written: any value that changes", at),
        CommandRegister(
            "command",
            "uint16",
            1,
            "written: 1 change product, 2 start batch, 3 stop batch, 4 acknowledge all alarms",
            at + 1,
        ),
        CommandRegister(
            "command_product", "uint16", 1, "written: number of the product; 0: the present one", at + 2
        ),
        CommandRegister(
            "command_name", "text", NAME_WORDS, "written: name of the batch, UTF-8, zeros behind it", at + 3
        ),
        CommandRegister(
            "request",
            "uint16",
            1,
            "written last: another value carries the command out",
            at + 3 + NAME_WORDS,
        ),
    )
    end = registers[-1].address
    for register in placed:
        if register.address <= end and register.address + register.words > at:
            raise InputError(
                f"[modbus.commands] first = {at}: the registers {at} to {end} overlap {register.name} at "
                f"{register.address}; choose another"
            )
    return registers


class ModbusCommands:
    """Takes what the control system writes; thread-safe."""

    def __init__(
        self,
        settings: ModbusSettings,
        plant: Plant,
        control: PlantCommands,
        users: PlantUsers | None,
        data: Path,
        on_message: Callable[[str], None],
        monotonic_s: Callable[[], float] = monotonic,
    ) -> None:
        """Read the last request that was carried out; a damaged file is set aside with a message."""
        assert settings.commands is not None
        self._settings, self._plant, self._control, self._users = settings.commands, plant, control, users
        self._on_message, self._monotonic_s = on_message, monotonic_s
        self._kept = KeptNumber(
            data / "modbus_request.json",
            "beltscape-modbus-request/1",
            "request",
            ("unit", settings.unit),
            "the next request that is written is carried out, also one that was before",
            on_message,
        )
        self._words = [0] * (4 + NAME_WORDS)
        self._words[-1] = self.done
        self._heartbeat_s = float("-inf")
        self._lock = threading.Lock()
        self.result = 0
        """1 done, 2 refused, 3 no heartbeat; 0: none since the start."""

    @property
    def done(self) -> int:
        """Return the newest request that was taken."""
        return self._kept.number or 0

    @property
    def words(self) -> Sequence[int]:
        """Return the registers as they were written last."""
        return tuple(self._words)

    def covers(self, address: int, count: int) -> bool:
        """Return whether all registers of a write are commands."""
        first = self._settings.first
        return first <= address and address + count <= first + len(self._words)

    def write(self, address: int, values: Sequence[int]) -> None:
        """Take a write, and carry the command out if it holds another request. OutputError if that cannot be kept."""
        with self._lock:
            begin, heartbeat = address - self._settings.first, self._words[0]
            self._words[begin : begin + len(values)] = values
            if self._words[0] != heartbeat:
                self._heartbeat_s = self._monotonic_s()
            if self._words[-1] != self.done:
                self._kept.keep(self._words[-1])
                self.result = self._carry_out()

    def _carry_out(self) -> int:
        code, number = self._words[1], self._words[2]
        if self._monotonic_s() - self._heartbeat_s > self._settings.heartbeat_s:
            self._on_message(
                f"modbus: command {code}: client_heartbeat has not changed for {self._settings.heartbeat_s:g} s; "
                "nothing was done"
            )
            return NO_HEARTBEAT
        try:
            detail = self._call(code, number)
        except BeltscapeError as error:
            self._on_message(f"modbus: {error}")
            return REFUSED
        if self._users is not None:
            self._users.write_audit(_ACTIONS[code], USER, "", detail)
        return DONE

    def _call(self, code: int, number: int) -> dict[str, str]:
        """Carry a command out; return what the audit log says of it."""
        if code == CHANGE_PRODUCT:
            product = self._find_product(number)
            if not product:
                raise InputError("command 1: command_product is 0; write the number of a product")
            self._control.change_product(product, USER)
            return {"product": product}
        if code == START_BATCH:
            name, product = self._read_name(), self._find_product(number)
            self._control.start_batch(name, product, USER)
            return {"batch": name, "product": product}
        if code == STOP_BATCH:
            name = self._plant.read_state().batch
            self._control.stop_batch(USER)
            return {"batch": name}
        if code == ACKNOWLEDGE:
            return {"alarms": ", ".join(self._acknowledge_all())}
        raise InputError(f"command {code}: no such command; there are 1 to {ACKNOWLEDGE}")

    def _find_product(self, number: int) -> str:
        """Return the name of a product by its number; empty for 0."""
        products = self._plant.read_state().products
        if number > len(products):
            raise InputError(f"command_product {number}: there are {len(products)} products")
        return products[number - 1] if number else ""

    def _read_name(self) -> str:
        data = b"".join(word.to_bytes(2, "big") for word in self._words[3 : 3 + NAME_WORDS])
        try:
            return data.partition(b"\0")[0].decode("utf-8")
        except UnicodeDecodeError as error:
            raise InputError("command_name: is no UTF-8") from error

    def _acknowledge_all(self) -> list[str]:
        waiting = [one.name for one in self._plant.read_state().alarms if one.state in ("raised", "gone")]
        for name in waiting:
            self._control.acknowledge(name, USER)
        return waiting


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
        self._commands: ModbusCommands | None = None
        if settings.commands is not None and control is not None:
            self._commands = ModbusCommands(settings, plant, control, users, data, on_message)
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

    def read(self) -> RegisterValues:
        """Return what the registers are filled from now."""
        state, commands = self._plant.read_state(), self._commands
        done, result = (0, 0) if commands is None else (commands.done, commands.result)
        if self._pulses is None:
            return RegisterValues(state, int(monotonic() - self._started_s), 0, done, result)
        totals = state.totals
        total = totals.mass_kg if self._settings.pulse_kg is not None else totals.volume_mm3 * 1e-6
        try:
            count = self._pulses.update(total)
        except OutputError as error:
            self._on_message(f"modbus: {error}; the pulse count waits")
            count = self._pulses.count
        return RegisterValues(state, int(monotonic() - self._started_s), count, done, result)

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

    async def _answer_write(self, commands: ModbusCommands, request: bytes) -> bytes:
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
