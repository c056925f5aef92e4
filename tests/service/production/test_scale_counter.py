"""The counter of a belt scale from a table and from registers, and what is reported of a scale that disagrees."""

from __future__ import annotations

import asyncio
import socket
import struct
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from beltscape.production.scale import ScaleReading
from beltscape.production.settings import ScaleModbusSettings, ScaleSettings
from beltscape.service.production.belt_scale import (
    ModbusCounter,
    ScaleError,
    ScaleWatch,
    TableCounter,
    check_scale,
)
from beltscape.service.production.figures import ProductionFigures
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from tests.service.production.plants import make_control
from tests.sinks.ledgers import START_NS, ledger

S_NS = 10**9


def test_a_growing_table_is_read_by_whole_rows(tmp_path: Path) -> None:
    path = tmp_path / "scale.csv"
    path.write_text("timestamp_s,kg\n100.5,1000\n101")
    counter = TableCounter(path, 0)
    assert counter.read() == [ScaleReading(100_500_000_000, 1000.0, "csv")]
    assert counter.read() == []
    with path.open("a") as file:
        file.write(".5,1010.5\n")
    assert counter.read() == [ScaleReading(101_500_000_000, 1010.5, "csv")]
    assert [r.kg for r in TableCounter(path, 100_500_000_000).read()] == [1010.5]  # after a restart


def test_a_new_table_in_its_place_is_read(tmp_path: Path) -> None:
    path = tmp_path / "scale.csv"
    path.write_text("timestamp_s,kg\n100,1000\n200,1000\n")
    counter = TableCounter(path, 0)
    counter.read()
    path.write_text("timestamp_s,kg\n300,5\n")
    assert [r.kg for r in counter.read()] == [5.0]


@pytest.mark.parametrize("row", ["a,b", "1,2,3", "nan,1", "1,inf", "-5,1", "1e12,1", "\ufffd\0,1", "1;2"])
def test_rows_that_are_none_are_named_and_left_out(tmp_path: Path, row: str) -> None:
    path = tmp_path / "scale.csv"
    path.write_text(f"timestamp_s,kg\n100,1\n{row}\n200,2\n")
    counter = TableCounter(path, 0)
    assert [r.kg for r in counter.read()] == [1.0, 2.0]
    with pytest.raises(ScaleError, match="is no row"):
        counter.read()
    assert counter.read() == []


def test_a_missing_table_is_reported(tmp_path: Path) -> None:
    with pytest.raises(ScaleError, match=r"none\.csv"):
        TableCounter(tmp_path / "none.csv", 0).read()


REGISTERS = list(struct.unpack(">14H", struct.pack(">HIQfd", 7, 70_000, 2**40, 1.5, 2.25) + b"\0\0"))[:13]


@pytest.fixture(scope="module")
def controller() -> Iterator[int]:
    """A controller that holds one counter in every form; its port."""
    pytest.importorskip("pymodbus")
    from pymodbus.server import ModbusTcpServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    ready, loop, port = threading.Event(), asyncio.new_event_loop(), list[int]()

    async def serve() -> None:
        blocks = [SimData(0, values=REGISTERS, datatype=DataType.REGISTERS)]
        server = ModbusTcpServer(SimDevice(1, blocks), address=("127.0.0.1", 0))
        await server.serve_forever(background=True)
        port.append(server.transport.sockets[0].getsockname()[1])  # pyrefly: ignore[missing-attribute]
        ready.set()
        while not done.is_set():
            await asyncio.sleep(0.02)
        await server.shutdown()

    done = threading.Event()
    thread = threading.Thread(target=lambda: loop.run_until_complete(serve()))
    thread.start()
    assert ready.wait(10)
    yield port[0]
    done.set()
    thread.join()
    loop.close()


@pytest.mark.parametrize(
    ("form", "address", "count"),
    [
        ("uint16", 0, 7),
        ("uint32", 1, 70_000),
        ("uint64", 3, 2**40),
        ("float32", 7, 1.5),
        ("float64", 9, 2.25),
    ],
)
@pytest.mark.parametrize("kind", ["holding", "input"])
def test_registers_are_read_in_every_form(
    controller: int, form: str, address: int, count: float, kind: str
) -> None:
    table = {
        "host": "127.0.0.1",
        "port": controller,
        "address": address,
        "form": form,
        "kind": kind,
        "kg_per_count": 10,
    }
    counter = ModbusCounter(ScaleModbusSettings.model_validate(table))
    (reading,) = counter.read()
    counter.close()
    assert reading.kg == count * 10
    assert reading.source == "modbus"


def test_a_controller_that_is_away_or_refuses_is_named(controller: int) -> None:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        free = one.getsockname()[1]
    away = ModbusCounter(ScaleModbusSettings(host="127.0.0.1", port=free, address=0))
    for _ in range(2):
        with pytest.raises(ScaleError, match=f"port {free}"):
            away.read()
    refused = ModbusCounter(ScaleModbusSettings(host="127.0.0.1", port=controller, address=5000))
    with pytest.raises(ScaleError, match="register 5000 is refused"):
        refused.read()
    refused.close()


def test_the_check_names_the_source(tmp_path: Path) -> None:
    assert "typed" in check_scale(ScaleSettings())
    assert "does not exist yet" in check_scale(ScaleSettings(csv=tmp_path / "scale.csv"))
    modbus = ScaleModbusSettings(host="10.1.2.3", address=7)
    assert check_scale(ScaleSettings(modbus=modbus)) == "10.1.2.3 port 502, register 7"


class Counts:
    """A counter that gives what the test put into it."""

    def close(self) -> None: ...

    def __init__(self) -> None:
        self.readings: list[ScaleReading] = []

    def read(self) -> list[ScaleReading]:
        found, self.readings = self.readings, []
        return found


@pytest.mark.parametrize(("factor", "reported"), [(1.0, 0), (1.02, 0), (1.3, 1), (0.7, 1)])
def test_a_scale_that_disagrees_is_reported_once(tmp_path: Path, factor: float, reported: int) -> None:
    history = Historian(tmp_path, HistorySettings())
    history.begin_run()
    clock = [START_NS]
    control = make_control(history, lambda: clock[0])
    number = control.start_batch("truck", "", "anna")
    clock[0] += 20 * S_NS
    history.write([replace(r, product="ore", batch=number) for r in ledger(6)])
    control.stop_batch("anna")
    history.write([replace(r, product="ore") for r in ledger(1, 7)])
    figures, counter, messages = ProductionFigures(control, ScaleSettings()), Counts(), list[str]()
    mass = history.production.batches(0, 1 << 62)[0].sums.mass_kg
    begin, end = START_NS // 1_000_000 * 1_000_000, START_NS + 20 * S_NS
    counter.readings = [ScaleReading(begin, 0.0, "csv"), ScaleReading(end, factor * mass, "csv")]
    for _ in range(2):  # and after a restart
        watch = ScaleWatch(figures, history, counter, 10.0, messages.append)
        watch.read()
        for _ in range(3):
            watch.compare(START_NS + 60 * S_NS)
        assert control.events.wait(20)
    assert len(messages) == reported
    assert [event.kind for event in history.events(0, 1 << 62)].count("scale") == reported
    history.close()
