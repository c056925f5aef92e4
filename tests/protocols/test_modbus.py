"""Modbus TCP: registers as a client reads them, totals that do not tear, a pulse count that never falls."""

from __future__ import annotations

import math
import random
import runpy
import socket
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from beltscape.core.alarms import Alarm
from beltscape.core.errors import InputError
from beltscape.core.ledger import Totals

pytest.importorskip("pymodbus", reason="pymodbus is not installed; pip install 'beltscape[modbus]' brings it")

from pymodbus.client import ModbusTcpClient

from beltscape.protocols.modbus import ModbusServer, PulseCount
from beltscape.protocols.modbus_registers import REGISTERS, RegisterValues, place_registers, write_csv
from beltscape.protocols.settings import ModbusSettings
from tests.protocols.plant import FakePlant

FORMS = {"uint16": ">H", "uint32": ">I", "uint64": ">Q", "int64": ">q", "float32": ">f"}


@pytest.fixture
def plant() -> FakePlant:
    """Return a plant whose totals need more than 32 bits."""
    one = FakePlant()
    totals = Totals(7, 6e9 * 1e6, 1e9, 5_000_000_123.4, 6_000_000_000.0, 20.0, 30.0)
    alarms = (
        Alarm("overload", "critical", "raised", 1.0, 2.0, "", 1),
        Alarm("dirt:cam0", "warning", "gone", 1.0, 2.0, "", 1),
    )
    one.state = replace(one.state, totals=totals, alarms=alarms, standing="degraded")
    return one


@pytest.fixture
def serve(plant: FakePlant, tmp_path: Path) -> Iterator[Any]:
    """Return a function that serves the plant and gives the server and a connected client."""
    opened: list[Any] = []

    def start(**settings: object) -> tuple[ModbusServer, ModbusTcpClient]:
        server = ModbusServer(ModbusSettings.model_validate({"port": 0, **settings}), plant, tmp_path)
        server.start()
        client = ModbusTcpClient("127.0.0.1", port=server.port)
        assert client.connect()
        opened[:0] = [client, server]
        return server, client

    yield start
    for one in opened:
        one.close()


def read_all(client: ModbusTcpClient, settings: ModbusSettings) -> dict[str, float]:
    """Return every value by name, read in one request."""
    registers = place_registers(settings)
    first, end = registers[0].address, registers[-1].address + registers[-1].words
    words = client.read_holding_registers(first, count=end - first, device_id=settings.unit or 1).registers
    values: dict[str, float] = {}
    for register in registers:
        own = words[register.address - first :][: register.words]
        own = own if settings.words == "big" else own[::-1]
        values[register.name] = struct.unpack(FORMS[register.form], struct.pack(f">{len(own)}H", *own))[0]
    return values


@pytest.mark.parametrize("words", ["big", "little"])
@pytest.mark.parametrize("first", [0, 1000])
def test_a_client_reads_every_value(serve, plant: FakePlant, words: str, first: int) -> None:
    settings = {"words": words, "first": first, "pulse_kg": 1000.0, "full_m3_h": 200.0}
    _, client = serve(**settings)
    values = read_all(client, ModbusSettings.model_validate(settings))
    assert values["flow_m3_h"] == pytest.approx(123.4)
    assert math.isnan(values["speed_m_s"])
    assert values["total_mass_kg"] == 5_000_000_123
    assert values["total_volume_l"] == 6_000_000_000
    assert values["total_valid_mm"] == 6_000_000_000
    assert values["quality"] == 1
    assert values["pulses"] == 5_000_000
    assert values["analogue_ua"] == round(4000 + 16_000 * 123.4 / 200)
    assert (values["alarms_critical"], values["alarms_warning"], values["cameras_ok"]) == (1, 0, 1)


def test_input_and_holding_registers_are_the_same_and_writes_are_refused(serve) -> None:
    _, client = serve()
    holding = client.read_holding_registers(1, count=5, device_id=1).registers
    assert client.read_input_registers(1, count=5, device_id=1).registers == holding
    assert client.write_register(1, 2, device_id=1).isError()
    assert client.read_holding_registers(1, count=5, device_id=1).registers == holding
    assert client.read_holding_registers(5000, count=2, device_id=1).isError()
    assert client.read_holding_registers(0, count=2, device_id=9).isError()


def test_totals_of_one_request_belong_together(serve, plant: FakePlant) -> None:
    _, client = serve()
    settings = ModbusSettings(port=0)
    for turn in range(30):
        # between requests the low words wrap, so that words of two readings would give another value
        total = 2.0**32 * (turn + 1) - (turn % 2)
        plant.state = replace(plant.state, totals=Totals(1, total * 1e6, 0.0, total, total, 0.0, 0.0))
        values = read_all(client, settings)
        assert values["total_volume_l"] == values["total_mass_kg"] == values["total_valid_mm"] == total


def test_chosen_addresses_are_served_alone(serve) -> None:
    addresses = {"total_mass_kg": 40, "flow_t_h": 10}
    _, client = serve(addresses=addresses)
    assert not client.read_holding_registers(10, count=2, device_id=1).isError()
    assert not client.read_holding_registers(40, count=4, device_id=1).isError()
    assert client.read_holding_registers(20, count=2, device_id=1).isError()


def test_addresses_that_overlap_or_name_nothing_are_refused() -> None:
    with pytest.raises(
        InputError, match="total_mass_kg takes the addresses 8 to 11, and flow_t_h begins at 10"
    ):
        place_registers(ModbusSettings(addresses={"total_mass_kg": 8, "flow_t_h": 10}))
    with pytest.raises(InputError, match="flow is no register; there are heartbeat, "):
        place_registers(ModbusSettings(addresses={"flow": 8}))


def test_a_port_in_use_is_named(tmp_path: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        server = ModbusServer(ModbusSettings(port=other.getsockname()[1]), FakePlant(), tmp_path)
        with pytest.raises(InputError, match="cannot be listened on"):
            server.start()


def make_request(number: int, pdu: bytes = b"\x03\x00\x00\x00\x02", unit: int = 1) -> bytes:
    """Return a request: by default a read of the first two holding registers."""
    return struct.pack(">HHHB", number, 0, len(pdu) + 1, unit) + pdu


def read_answers(client: socket.socket, count: int) -> list[tuple[int, bytes]]:
    """Return the next answers of a connection: transaction number and data."""
    file, answers = client.makefile("rb"), list[tuple[int, bytes]]()
    for _ in range(count):
        number, _, size, _ = struct.unpack(">HHHB", file.read(7))
        answers.append((number, file.read(size - 1)))
    return answers


def cut(data: bytes, pieces: int) -> list[bytes]:
    return [data[k * len(data) // pieces : (k + 1) * len(data) // pieces] for k in range(pieces)]


@pytest.mark.parametrize(("requests", "segments"), [(1, 3), (3, 1), (3, 2), (40, 7), (12, 12 * 12)])
def test_every_request_is_answered_however_the_network_cuts_them(serve, requests: int, segments: int) -> None:
    server, _ = serve()
    numbers = [1000 + 7 * k for k in range(requests)]
    with socket.create_connection(("127.0.0.1", server.port), timeout=20) as client:
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for segment in cut(b"".join(map(make_request, numbers)), segments):
            client.sendall(segment)
        answers = read_answers(client, requests)
    assert [number for number, _ in answers] == numbers
    assert {len(data) for _, data in answers} == {2 + 4}


def test_clients_at_once_get_their_own_answers(serve) -> None:
    server, _ = serve()
    clients = [socket.create_connection(("127.0.0.1", server.port), timeout=20) for _ in range(20)]
    for k, client in enumerate(clients):  # all are in the middle of their first request
        client.sendall((make_request(100 * k) + make_request(100 * k + 1))[:5])
    for k, client in reversed(list(enumerate(clients))):
        client.sendall((make_request(100 * k) + make_request(100 * k + 1))[5:])
        assert [number for number, _ in read_answers(client, 2)] == [100 * k, 100 * k + 1]
        client.close()


def test_connections_that_were_left_open_do_not_keep_others_out(serve) -> None:
    server, _ = serve()
    left = [socket.create_connection(("127.0.0.1", server.port), timeout=20) for _ in range(100)]
    with socket.create_connection(("127.0.0.1", server.port), timeout=20) as client:
        client.sendall(make_request(1))
        assert [number for number, _ in read_answers(client, 1)] == [1]
    for one in left:
        one.close()


@pytest.mark.parametrize(
    ("pdu", "code"),
    [
        (b"\x01\x00\x00\x00\x02", 1),  # coils
        (b"\x2b\x0e\x01\x00", 1),  # identification
        (b"\x06\x00\x00\x00\x02", 1),  # there are no commands
        (b"\x03\x0f\xff\x00\x02", 2),
        (b"\x03\x00\x00\x00\x00", 3),
        (b"\x04\x00\x00\x00\x7e", 3),
        (b"\x03\x00", 3),
    ],
)
def test_what_cannot_be_answered_is_an_exception_and_the_next_request_is_answered(
    serve, pdu: bytes, code: int
) -> None:
    server, _ = serve()
    with socket.create_connection(("127.0.0.1", server.port), timeout=20) as client:
        client.sendall(make_request(1, pdu) + make_request(2, unit=9) + make_request(3))
        answers = read_answers(client, 3)
    assert [number for number, _ in answers] == [1, 2, 3]
    assert answers[0][1] == bytes((pdu[0] | 0x80, code))
    assert answers[1][1] == b"\x83\x0b"
    assert answers[2][1][:2] == b"\x03\x04"


def test_a_state_that_cannot_be_read_is_an_exception_and_reported_once(
    serve, plant: FakePlant, monkeypatch: pytest.MonkeyPatch
) -> None:
    server, _ = serve()
    messages = list[str]()
    monkeypatch.setattr(server, "_on_message", messages.append)
    monkeypatch.setattr(plant, "read_state", lambda: 1 / 0)  # pyrefly: ignore[division-by-zero]
    with socket.create_connection(("127.0.0.1", server.port), timeout=20) as client:
        client.sendall(make_request(1) + make_request(2))
        assert read_answers(client, 2) == [(1, b"\x83\x04"), (2, b"\x83\x04")]
    assert messages == ["modbus: ZeroDivisionError: division by zero; a request was not answered"]


def test_garbage_on_the_port_stops_nothing(serve, plant: FakePlant) -> None:
    server, client = serve()
    rng = random.Random(3)
    for _ in range(60):
        with socket.create_connection(("127.0.0.1", server.port)) as fuzz:
            fuzz.sendall(rng.randbytes(rng.randint(1, 300)))
    assert read_all(client, ModbusSettings(port=0))["total_volume_l"] == 6_000_000_000


def test_pulses_never_fall_and_survive_a_restart(tmp_path: Path) -> None:
    path, rng = tmp_path / "pulses.json", random.Random(7)
    total, highest, shown = 0.0, 0.0, 0
    counter = PulseCount(path, 25.0)
    for _ in range(200):
        if rng.random() < 0.3:  # a restart
            counter = PulseCount(path, 25.0)
        total += rng.uniform(-5, 20)
        highest = max(highest, total)
        pulses = counter.update(total)
        assert pulses >= shown
        assert pulses == max(shown, math.floor(total / 25 + 1e-9))
        shown = pulses
    assert shown == math.floor(highest / 25 + 1e-9)
    assert PulseCount(path, 25.0).update(math.nan) == shown
    assert PulseCount(path, 10.0).count == 0  # another step counts anew


def test_a_flow_that_is_not_known_is_a_broken_loop(plant: FakePlant) -> None:
    (analogue,) = (one for one in REGISTERS if one.name == "analogue_ua")
    settings = ModbusSettings(full_t_h=100.0)
    missing = replace(plant.state, standing="missing")
    assert analogue.read(RegisterValues(missing, 0, 0), settings) == 3500
    full = replace(plant.state, mass_flow_t_h=500.0)
    assert analogue.read(RegisterValues(full, 0, 0), settings) == 20_500
    assert analogue.read(RegisterValues(plant.state, 0, 0), ModbusSettings()) == 3500


def test_the_map_is_a_table_without_gaps() -> None:
    lines = write_csv(place_registers(ModbusSettings(first=100))).splitlines()
    assert lines[0] == "address,name,form,words,unit,meaning"
    rows = [line.split(",") for line in lines[1:]]
    ends = [int(row[0]) + int(row[3]) for row in rows]
    assert [int(row[0]) for row in rows] == [100, *ends[:-1]]


def test_the_manual_holds_the_map() -> None:
    tool = runpy.run_path(str(Path(__file__).resolve().parents[2] / "tools/write_register_map.py"))
    text = tool["PAGE"].read_text("utf-8")
    assert tool["fill_page"](text) == text, "run python tools/write_register_map.py"
