"""Commands by Modbus: carried out once each, with a heartbeat, never after a restart again."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from beltscape.core.errors import InputError

pytest.importorskip("pymodbus", reason="pymodbus is not installed; pip install 'beltscape[modbus]' brings it")

from hypothesis import given
from hypothesis import strategies as st
from pymodbus.client import ModbusTcpClient

from beltscape.protocols.modbus import NAME_WORDS, ModbusCommands, ModbusServer, place_commands
from beltscape.protocols.modbus_registers import place_registers, write_csv
from beltscape.protocols.settings import ModbusSettings
from tests.protocols.plant import FakePlant
from tests.thorough import examples

SETTINGS = ModbusSettings.model_validate({"port": 0, "commands": {"first": 100}})


class Control:
    """Keeps the commands it is given."""

    def __init__(self, plant: FakePlant) -> None:
        self.calls: list[tuple[str, ...]] = []
        self.audit: list[tuple[str, str]] = []
        self._plant = plant

    def acknowledge(self, alarm: str, user: str) -> None:
        self.calls.append(("acknowledge", alarm, user))

    def start_batch(self, name: str, product: str, user: str) -> None:
        if self._plant.state.batch:
            raise InputError(f"batch {self._plant.state.batch} is open; stop it first")
        self._plant.state = replace(self._plant.state, batch=name)
        self.calls.append(("start", name, product, user))

    def stop_batch(self, user: str) -> None:
        self._plant.state = replace(self._plant.state, batch="")
        self.calls.append(("stop", user))

    def change_product(self, name: str, user: str) -> None:
        self._plant.state = replace(self._plant.state, product=name)
        self.calls.append(("product", name, user))

    def find_by_password(self, name: str, password: str, address: str) -> str | None:
        return None

    def has_role(self, user: str, role: str) -> bool:
        return False

    def write_audit(self, action: str, user: str, address: str, detail: Mapping[str, str]) -> None:
        self.audit.append((action, user))


class Client:
    """A control system: writes a command, then its request; reads product, batch, done and result."""

    def __init__(self, port: int) -> None:
        self.modbus = ModbusTcpClient("127.0.0.1", port=port)
        assert self.modbus.connect()
        self._beat = 0

    def beat(self) -> None:
        self._beat += 1
        answer = self.modbus.write_register(100, self._beat, device_id=1)
        assert not answer.isError(), answer

    def send(self, request: int, command: int, product: int = 0, name: str = "") -> None:
        data = name.encode().ljust(2 * NAME_WORDS, b"\0")
        words = [int.from_bytes(data[at : at + 2], "big") for at in range(0, 2 * NAME_WORDS, 2)]
        answer = self.modbus.write_registers(101, [command, product, *words, request], device_id=1)
        assert not answer.isError()

    def read(self) -> list[int]:
        return list(self.modbus.read_holding_registers(45, count=4, device_id=1).registers)


@pytest.fixture
def plant() -> FakePlant:
    one = FakePlant()
    one.state = replace(one.state, products=("ore", "coal"), product="ore")
    return one


@pytest.fixture
def served(plant: FakePlant, tmp_path: Path) -> Iterator[tuple[Control, Client]]:
    control = Control(plant)
    server = ModbusServer(SETTINGS, plant, tmp_path, control=control, users=control)
    server.start()
    client = Client(server.port)
    yield control, client
    client.modbus.close()
    server.close()


def test_a_control_system_changes_product_and_batch(served: tuple[Control, Client]) -> None:
    control, client = served
    client.beat()
    assert client.read() == [1, 0, 0, 0]
    client.send(7, 1, product=2)
    assert client.read() == [2, 0, 7, 1]
    client.send(8, 2, product=1, name="MS Grüße")
    assert client.read() == [2, 1, 8, 1]
    client.send(9, 2, name="another")
    assert client.read() == [2, 1, 9, 2]  # refused: one is open
    client.send(10, 3)
    assert client.read() == [2, 0, 10, 1]
    assert control.calls == [
        ("product", "coal", "modbus"),
        ("start", "MS Grüße", "ore", "modbus"),
        ("stop", "modbus"),
    ]
    assert control.audit == [
        ("change_product", "modbus"),
        ("start_batch", "modbus"),
        ("stop_batch", "modbus"),
    ]


def test_a_request_that_is_written_again_does_nothing(served: tuple[Control, Client]) -> None:
    control, client = served
    client.beat()
    for _ in range(3):
        client.send(5, 1, product=2)
    assert len(control.calls) == 1


def test_nothing_happens_without_a_heartbeat(served: tuple[Control, Client]) -> None:
    control, client = served
    client.send(1, 1, product=2)
    assert client.read()[2:] == [1, 3]
    assert control.calls == []
    client.beat()
    client.send(2, 1, product=2)
    assert client.read()[2:] == [2, 1]


def test_what_cannot_be_is_refused(served: tuple[Control, Client]) -> None:
    control, client = served
    client.beat()
    for request, (command, product) in enumerate([(0, 0), (5, 0), (1, 3), (1, 0), (65_535, 1)], 1):
        client.send(request, command, product)
        assert client.read()[2:] == [request, 2]
    assert control.calls == []
    for address, values in ((45, [1]), (99, [1, 1]), (119, [1, 1]), (200, [1])):
        assert client.modbus.write_registers(address, values, device_id=1).isError()
    assert client.modbus.write_coil(100, True, device_id=1).isError()


def test_without_the_table_nothing_is_written(plant: FakePlant, tmp_path: Path) -> None:
    control = Control(plant)
    server = ModbusServer(ModbusSettings(port=0), plant, tmp_path, control=control, users=control)
    server.start()
    client = Client(server.port)
    for address in (0, 45, 100, 1000):
        assert client.modbus.write_register(address, 1, device_id=1).isError()
    client.modbus.close()
    server.close()


def test_a_stale_heartbeat_and_a_restart(plant: FakePlant, tmp_path: Path) -> None:
    clock, control = [0.0], Control(plant)

    def open_commands() -> ModbusCommands:
        return ModbusCommands(SETTINGS, plant, control, control, tmp_path, lambda _: None, lambda: clock[0])

    commands = open_commands()
    commands.write(100, [1])
    clock[0] = 9.0
    commands.write(101, [1, 2])
    commands.write(119, [4])
    assert commands.result == 1
    clock[0] = 11.0
    commands.write(100, [1])  # written, but not changed
    commands.write(119, [5])
    assert commands.result == 3
    again = open_commands()
    assert (again.done, again.result) == (5, 0)
    again.write(100, [2, 1, 2])
    again.write(119, [5])  # the control system writes its last request again
    assert again.result == 0
    assert len(control.calls) == 1


@examples(60)
@given(words=st.lists(st.integers(0, 65_535), min_size=20, max_size=20))
def test_any_words_are_taken_without_a_failure(
    tmp_path_factory: pytest.TempPathFactory, words: list[int]
) -> None:
    plant = FakePlant()
    commands = ModbusCommands(
        SETTINGS, plant, Control(plant), None, tmp_path_factory.mktemp("m"), lambda _: None
    )
    commands.write(100, words)
    assert commands.result in (0, 1, 2, 3)


def test_commands_stand_in_the_map_and_overlap_nothing() -> None:
    placed = place_registers(SETTINGS)
    text = write_csv([*placed, *place_commands(SETTINGS, placed)])
    assert "100,client_heartbeat,uint16,1" in text
    assert "119,request,uint16,1" in text
    for first in (0, 30, 48):
        wrong = ModbusSettings.model_validate({"commands": {"first": first}})
        with pytest.raises(InputError, match="overlap"):
            place_commands(wrong, place_registers(wrong))
    assert place_commands(ModbusSettings(), placed) == ()
