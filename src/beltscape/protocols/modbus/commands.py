"""Commands of a control system: registers that it writes, carried out once each while its heartbeat is seen.

The control system writes command, product and name, and last a ``request`` that differs from ``command_done``. The
request is kept before it is carried out, so a restart repeats none.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from time import monotonic

from beltscape.core.errors import BeltscapeError, InputError
from beltscape.protocols.kept_number import KeptNumber
from beltscape.protocols.modbus.registers import CommandRegister, Register
from beltscape.protocols.modbus.settings import ModbusSettings
from beltscape.protocols.plant import Plant, PlantCommands, PlantUsers

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


class Commands:
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
