"""What the protocols see of a running system, and their start and end beside it."""

from __future__ import annotations

import json
import math
import socket
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from beltscape.core.alarms import Alarm
from beltscape.core.errors import InputError, OutputError
from beltscape.protocols.settings import ModbusSettings, MqttSettings, OpcUaSettings, OutputSettings
from beltscape.service.live_state import LiveState
from beltscape.service.protocol_checks import check_modbus, check_mqtt, check_outputs
from beltscape.service.protocols import STARTERS, ProtocolSettings, ServedPlant, serve_protocols
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from tests.protocols.broker import find_port, wait_until
from tests.protocols.plant import make_record


@pytest.fixture
def historian(tmp_path: Path) -> Iterator[Historian]:
    """Return a historian with five records, closed at the end."""
    one = Historian(tmp_path, HistorySettings(reserve_mib=1))
    run = one.begin_run()
    one.write([replace(make_record(number), run=run) for number in range(1, 6)])
    yield one
    one.close()


def acknowledge(alarm: str, _: str) -> bool:
    """Acknowledge one alarm only."""
    return alarm == "overload"


def test_the_served_plant_gives_stored_records_and_the_present_state(historian: Historian) -> None:
    live_state = LiveState()
    plant = ServedPlant(live_state, historian, acknowledge)
    assert plant.read_last_number() == 5
    assert [record.number for record in plant.read_records(2, 2)] == [3, 4]
    state = plant.read_state()
    assert (state.record, state.standing) == (5, "missing")  # nothing was measured since the start
    assert math.isnan(state.volume_flow_m3_h)
    assert math.isnan(state.speed_m_s)
    assert state.totals.volume_mm3 == pytest.approx(5 * 200_000)


def test_commands_are_done_or_refused_with_one_line(historian: Historian) -> None:
    live_state = LiveState()
    plant = ServedPlant(live_state, historian, acknowledge)
    live_state.on_alarms([
        Alarm(name, "warning", "raised", 1.0, 2.0, "", 1) for name in ("overload", "dirt:cam0")
    ])  # fmt: skip
    plant.acknowledge("overload", "anna")
    with pytest.raises(InputError, match="alarm 'dirt:cam0': is not waiting"):
        plant.acknowledge("dirt:cam0", "anna")
    with pytest.raises(InputError, match="alarm 'none': there is no alarm"):
        plant.acknowledge("none", "anna")


def test_modbus_is_served_during_the_context_only(historian: Historian, tmp_path: Path) -> None:
    client_module = pytest.importorskip("pymodbus.client", reason="pip install 'beltscape[modbus]'")
    settings = ModbusSettings(port=find_port())
    client = client_module.ModbusTcpClient("127.0.0.1", port=settings.port, retries=0, timeout=1)
    served = ServedPlant(LiveState(), historian, acknowledge)
    with serve_protocols(ProtocolSettings(modbus=settings), served, tmp_path, lambda _: None):
        assert client.connect()
        words = client.read_holding_registers(16, count=2, device_id=1).registers
        assert words == [0, 5]  # record
        client.close()
    assert not client.connect()
    assert (tmp_path / "modbus.csv").read_text("utf-8").startswith("address,name,form")


def test_what_the_disk_refuses_stops_no_start(
    historian: Historian, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "modbus.csv").mkdir()  # a folder in its place: it cannot be written
    settings, messages = ModbusSettings(port=find_port(), pulse_l=0.1), list[str]()
    (tmp_path / "pulses.json").write_bytes(b"")
    served = ServedPlant(LiveState(), historian, acknowledge)

    def refuse(*_: object) -> None:
        raise OutputError("certificate.der: the disk is full; free some space")

    monkeypatch.setitem(STARTERS, "opcua", refuse)
    with serve_protocols(
        ProtocolSettings(modbus=settings, opcua=OpcUaSettings()), served, tmp_path, messages.append
    ):
        wait_until((tmp_path / "pulses.json").exists)
        assert json.loads((tmp_path / "pulses.json").read_text())["count"] == 10
        with socket.create_connection(("127.0.0.1", settings.port)):
            pass
    assert sorted(one.partition(":")[0] for one in messages)[-2:] == ["modbus", "opcua"]
    assert any("pulses.json: is empty and was moved to" in one for one in messages)


def test_an_absent_module_is_named_and_stops_nothing(historian: Historian, tmp_path: Path) -> None:
    pytest.importorskip("pymodbus", reason="pip install 'beltscape[modbus]'")
    messages: list[str] = []
    outputs = {"host": "127.0.0.1", "port": find_port(), "pulse": {"l": 5, "kind": "counter", "address": 0}}
    settings = ProtocolSettings(outputs=OutputSettings.model_validate(outputs))
    plant = ServedPlant(LiveState(), historian, acknowledge)
    with serve_protocols(settings, plant, tmp_path, messages.append):
        wait_until(lambda: bool(messages))
    assert "outputs: 127.0.0.1" in messages[0]
    assert "cannot be connected" in messages[0]


def test_an_absent_broker_stops_nothing(historian: Historian, tmp_path: Path) -> None:
    pytest.importorskip("paho", reason="pip install 'beltscape[mqtt]'")
    served = ServedPlant(LiveState(), historian, acknowledge)
    settings = ProtocolSettings(MqttSettings(host="127.0.0.1", port=find_port()))
    with serve_protocols(settings, served, tmp_path, lambda _: None):
        pass
    assert (tmp_path / "mqtt.json").is_file()


def test_checks_name_what_is_served_and_what_is_missing(tmp_path: Path) -> None:
    pytest.importorskip("paho", reason="pip install 'beltscape[mqtt]'")
    pytest.importorskip("pymodbus", reason="pip install 'beltscape[modbus]'")
    assert check_mqtt(MqttSettings(host="broker", tls=True)) == "broker port 8883, TLS, topic beltscape/belt"
    assert check_modbus(ModbusSettings(first=100)) == "127.0.0.1 port 502, registers 100 to 148"
    sparkplug = MqttSettings(host="broker", payload="sparkplug")
    assert check_mqtt(sparkplug).endswith("topic spBv1.0/Beltscape/beltscape/belt")
    outputs = OutputSettings.model_validate({"host": "io", "pulse": {"kg": 5, "address": 0}})
    assert check_outputs(outputs) == "io port 502, pulses as a coil, 0 currents"
    with pytest.raises(InputError, match="no such file"):
        check_mqtt(MqttSettings(host="broker", tls_ca=tmp_path / "none.pem"))
