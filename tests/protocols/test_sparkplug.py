"""Sparkplug B: births, aliases, sequence numbers, rebirth and death, and every record at a host at least once."""

from __future__ import annotations

import random
import time
from dataclasses import replace
from pathlib import Path

import pytest
from pydantic import ValidationError

pytest.importorskip("paho", reason="paho-mqtt is not installed; pip install 'beltscape[mqtt]' brings it")
pytest.importorskip(
    "google.protobuf", reason="protobuf is not installed; pip install 'beltscape[mqtt]' brings it"
)

from beltscape.core.alarms import Alarm
from beltscape.protocols.mqtt.publisher import Publisher
from beltscape.protocols.mqtt.sparkplug import PrimaryHost
from beltscape.protocols.mqtt.sparkplug_payload import REBIRTH, Metric, encode, is_rebirth
from beltscape.protocols.settings import MqttSettings
from tests.protocols.broker import Broker, find_port, wait_until, with_broker
from tests.protocols.plant import FakePlant
from tests.protocols.sparkplug_host import Host, decode
from tests.protocols.test_mqtt import drop_repeats

pytestmark = pytest.mark.usefixtures("short_pauses")


def make_publisher(broker: Broker, plant: FakePlant, data: Path, host: str = "") -> Publisher:
    data.mkdir(exist_ok=True)
    settings = MqttSettings.model_validate({
        "host": "127.0.0.1", "port": broker.port, "payload": "sparkplug", "first": "all", "state_every_s": 0.2,
        "sparkplug": {"group": "plant", "node": "tower", "device": "belt", "primary_host": host},
    })  # fmt: skip
    return Publisher(settings, plant, data)


@with_broker
def test_births_data_rebirth_and_death(broker: Broker, tmp_path: Path) -> None:
    plant, host = FakePlant(), Host(broker.port)
    plant.add(300)
    publisher = make_publisher(broker, plant, tmp_path / "data")
    publisher.start()
    wait_until(lambda: len(host.records) == 300)
    assert host.numbers == list(range(1, 301))  # the sequence number wrapped
    assert all(host.historical)  # they are old
    assert host.births == [0]
    first = host.messages[0]
    assert first[0] == "spBv1.0/plant/NBIRTH/tower"
    assert {metric["name"] for metric in first[1]["metrics"]} >= {"bdSeq", REBIRTH}
    assert all(metric["alias"] is None for metric in first[1]["metrics"])
    (birth,) = [one for topic, one, _, _ in host.messages if "DBIRTH" in topic]
    metrics = {metric["name"]: metric for metric in birth["metrics"]}
    assert metrics["Flow/Volume"]["value"] == 123.4
    assert metrics["Flow/Volume"]["properties"] == {"Quality": 192, "engUnit": "m³/h"}
    assert metrics["Belt/Speed"].get("is_null")
    assert metrics["Belt/Speed"]["properties"]["Quality"] == 0
    assert metrics["Alarms/overload"]["value"] == "clear"
    assert metrics["Record/Number"].get("is_null")
    assert {(qos, retain) for _, _, qos, retain in host.messages} == {(0, False)}
    record = host.records[6]
    assert (record["Record/Number"], record["Record/Standing"]) == (7, "valid")
    assert record["Record/Volume"] == pytest.approx(0.0002)
    plant.state = replace(plant.state, volume_flow_m3_h=99.0, standing="missing")
    wait_until(lambda: host.values["Flow/Volume"] == 99.0)
    plant.state = replace(
        plant.state, alarms=(*plant.state.alarms, Alarm("dirt", "warning", "raised", 1.0, 2.0, "", 1))
    )
    wait_until(lambda: host.values.get("Alarms/dirt") == "raised")  # by another birth of the device
    host.send(encode(1, [Metric("Boolean", True, 1, REBIRTH)]))
    wait_until(lambda: host.births == [0, 0])
    plant.add(1)
    wait_until(lambda: len(host.records) == 301)
    publisher.close()
    wait_until(lambda: host.deaths == [0])
    assert host.wrong == []
    host.close()


@pytest.mark.thorough
@with_broker
def test_no_record_is_lost_while_host_broker_or_program_are_away(broker: Broker, tmp_path: Path) -> None:
    plant, rng = FakePlant(), random.Random(9)
    publisher = make_publisher(broker, plant, tmp_path / "data", host="scada")
    publisher.start()
    plant.add(30)
    time.sleep(0.3)
    assert publisher.waiting == 30
    host = Host(broker.port, "scada")
    host.set_online(online=True)
    wait_until(lambda: publisher.waiting == 0)
    for _ in range(2):
        host.set_online(online=False)
        plant.add(rng.randint(10, 200))
        time.sleep(0.4)
        assert publisher.waiting > 0
        host.set_online(online=True)
        wait_until(lambda: publisher.waiting == 0)
    kept = (tmp_path / "data/mqtt.json").read_bytes()
    plant.add(100)
    wait_until(lambda: publisher.waiting == 0)
    publisher.close()
    (tmp_path / "data/mqtt.json").write_bytes(
        kept
    )  # as if it had been killed before the newer one was written
    broker.stop(kill=True)
    plant.add(50)
    second = make_publisher(broker, plant, tmp_path / "data", host="scada")
    second.start()
    broker.start()
    wait_until(host.is_connected)
    host.set_online(online=True)
    wait_until(lambda: len(set(host.numbers)) == plant.read_last_number(), 30)
    assert drop_repeats(host.numbers) == list(range(1, plant.read_last_number() + 1))
    assert host.wrong == []
    assert host.births == sorted(set(host.births))  # every session has a number of its own
    second.close()
    host.close()


def test_states_of_the_host() -> None:
    host = PrimaryHost("scada")
    topic = "spBv1.0/STATE/scada"
    assert not host.is_online
    for junk in (b"", b"\xff\xfe", b"[]", b"{}", b'{"online": 1, "timestamp": 5}', b'{"online": true}'):
        host.handle(topic, junk)
    assert not host.is_online
    host.handle("spBv1.0/STATE/other", b'{"online": true, "timestamp": 5}')
    assert not host.is_online
    host.handle(topic, b'{"online": true, "timestamp": 5}')
    host.note_published(17)
    host.note_published(40)
    assert host.is_online
    assert host.missed_after is None
    host.handle(topic, b'{"online": false, "timestamp": 4}')  # the death of an earlier session
    assert host.is_online
    host.handle(topic, b'{"online": false, "timestamp": 6}')
    assert (host.is_online, host.was_lost, host.missed_after) == (False, True, 17)
    host.handle("STATE/scada", b"ONLINE")
    assert host.is_online
    assert PrimaryHost("").is_online


def test_payloads_survive_an_independent_decoder_and_fuzz() -> None:
    metrics = [
        Metric("Int64", -7, 5, "a", 1),
        Metric("UInt64", 2**64 - 1, 6, alias=2, is_historical=True, quality=192),
        Metric("Int32", -1, 7, "c"),
        Metric("String", "größer 矿", 8, "d", unit="m³"),
        Metric("Double", float("nan"), 9, "e"),
        Metric("Boolean", False, 10, "f"),
    ]
    payload = decode(encode(11, metrics, 255))
    assert (payload["timestamp"], payload["seq"]) == (11, 255)
    values = [metric["value"] for metric in payload["metrics"]]
    assert values == [-7, 2**64 - 1, -1, "größer 矿", None, False]
    assert [metric["timestamp"] for metric in payload["metrics"]] == [5, 6, 7, 8, 9, 10]
    assert payload["metrics"][4]["is_null"]
    rng = random.Random(2)
    for _ in range(2000):
        assert not is_rebirth(rng.randbytes(rng.randint(0, 60)))
    assert not is_rebirth(encode(1, [Metric("Boolean", False, 1, REBIRTH)]))
    assert is_rebirth(encode(1, [Metric("Boolean", True, 1, REBIRTH)]))


@pytest.mark.parametrize("name", ["a/b", "+", "a#", ""])
def test_names_that_no_topic_takes_are_refused(name: str) -> None:
    with pytest.raises(ValidationError, match="group"):
        MqttSettings.model_validate({"host": "broker", "sparkplug": {"group": name}})


def test_a_broker_that_is_not_there_is_named(tmp_path: Path) -> None:
    messages: list[str] = []
    settings = MqttSettings(host="127.0.0.1", port=find_port(), payload="sparkplug")
    publisher = Publisher(settings, FakePlant(), tmp_path, messages.append)
    publisher.start()
    wait_until(lambda: bool(messages))
    assert "not connected" in messages[0]
    publisher.close()
