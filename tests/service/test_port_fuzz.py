"""Hostile bytes on the ports of page, Modbus and OPC UA: no thread ends, no record is lost, all still answer."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from tests.service.port_fuzz import RECORDS, attack, is_answering, list_threads, run_service

CONNECTIONS = 40


@pytest.mark.thorough
def test_ports_withstand_hostile_bytes(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    for name in ("pymodbus", "asyncua"):
        pytest.importorskip(name, reason="pip install 'beltscape[modbus,opcua]'")
    with run_service(tmp_path) as service:
        before = list_threads()
        attacker = threading.Thread(target=attack, args=(service.ports, 27, CONNECTIONS))
        attacker.start()
        while attacker.is_alive():
            service.plant.step()
            attacker.join(0.2)
        assert before - list_threads() == set()
        assert {name: is_answering(name, port) for name, port in service.ports.items()} == dict.fromkeys(
            service.ports, True
        )
        records = service.historian.records(0, 1 << 62, 10_000)
        assert [one.number for one in records] == [*range(1, service.plant.number + 1)]
        assert service.plant.number > RECORDS
    # a client that reaches a port must not be able to fill the log
    lines = [one.getMessage() for one in caplog.records if one.name != "beltscape.access"]
    assert len(lines) < 5, lines
    assert len(capfd.readouterr().err.splitlines()) < 5
