"""MQTT: every record reaches the broker at least once and in order, whatever happens to broker and program."""

from __future__ import annotations

import json
import random
import time
from pathlib import Path

import pytest
from pydantic import ValidationError

from beltscape.core.errors import InputError

pytest.importorskip("paho", reason="paho-mqtt is not installed; pip install 'beltscape[mqtt]' brings it")

from beltscape.protocols.mqtt.json_channel import format_alarm, format_record, format_state
from beltscape.protocols.mqtt.publisher import Publisher, check_settings, read_cursor
from beltscape.protocols.settings import MqttSettings
from tests.protocols.broker import (
    MQTT_3_REFUSAL,
    Broker,
    Subscriber,
    answer_every_client,
    find_port,
    wait_until,
    with_broker,
)
from tests.protocols.plant import FakePlant, make_record
from tests.service.access.certificates import make_certificate

TOPIC = "plant/belt4"
pytestmark = pytest.mark.usefixtures("short_pauses")


def make_publisher(broker: Broker, plant: FakePlant, data: Path, **settings: object) -> Publisher:
    """Return a publisher that publishes the whole ledger."""
    data.mkdir(exist_ok=True)
    values = {"host": "127.0.0.1", "port": broker.port, "topic": TOPIC, "first": "all", "state_every_s": 0.2}
    return Publisher(MqttSettings.model_validate({**values, **settings}), plant, data)


def drop_repeats(numbers: list[int]) -> list[int]:
    """Return each number once, at its first place."""
    return list(dict.fromkeys(numbers))


@with_broker
def test_records_arrive_in_order_with_state_alarms_and_status(broker: Broker, tmp_path: Path) -> None:
    plant, subscriber = FakePlant(), Subscriber(broker.port, TOPIC)
    plant.add(450)
    publisher = make_publisher(broker, plant, tmp_path / "data")
    publisher.start()
    wait_until(lambda: len(subscriber.numbers) >= 450)
    plant.add(3)
    wait_until(lambda: len(subscriber.numbers) >= 453)
    assert subscriber.numbers == list(range(1, 454))
    wait_until(lambda: subscriber.last("alarms/overload") is not None and publisher.waiting == 0)
    state = subscriber.last("state")
    assert state["flow_m3_h"] == 123.4
    assert state["speed_m_s"] is None  # not known
    assert state["quality"] == "good"
    assert subscriber.last("status") == "online"
    publisher.close()
    wait_until(lambda: subscriber.last("status") == "offline")
    subscriber.close()


@with_broker
def test_no_record_is_lost_while_the_broker_is_away(broker: Broker, tmp_path: Path) -> None:
    plant, subscriber = FakePlant(), Subscriber(broker.port, TOPIC)
    publisher = make_publisher(broker, plant, tmp_path / "data")
    publisher.start()
    rng = random.Random(5)
    for _ in range(3):
        plant.add(rng.randint(20, 300))
        time.sleep(rng.uniform(0.0, 0.3))
        broker.stop()
        plant.add(rng.randint(20, 300))
        time.sleep(0.2)
        broker.start()
        wait_until(lambda: publisher.waiting == 0, 40)
    wait_until(lambda: len(drop_repeats(subscriber.numbers)) == plant.read_last_number(), 40)
    assert drop_repeats(subscriber.numbers) == list(range(1, plant.read_last_number() + 1))
    publisher.close()
    subscriber.close()


@with_broker
def test_a_killed_program_goes_on_behind_the_last_acknowledged_record(broker: Broker, tmp_path: Path) -> None:
    plant, subscriber, data = FakePlant(), Subscriber(broker.port, TOPIC), tmp_path / "data"
    plant.add(250)
    first = make_publisher(broker, plant, data)
    first.start()
    wait_until(lambda: len(subscriber.numbers) >= 200)
    cursor = (data / "mqtt.json").read_bytes()
    wait_until(lambda: first.waiting == 0)
    first.close()
    (data / "mqtt.json").write_bytes(cursor)  # as if it had been killed before the newer one was written
    plant.add(50)
    second = make_publisher(broker, plant, data)
    second.start()
    wait_until(lambda: second.waiting == 0)
    wait_until(lambda: max(subscriber.numbers) == 300)
    assert drop_repeats(subscriber.numbers) == list(range(1, 301))
    second.close()
    subscriber.close()


@with_broker
def test_a_new_broker_gets_records_from_then_on_only(broker: Broker, tmp_path: Path) -> None:
    plant, subscriber = FakePlant(), Subscriber(broker.port, TOPIC)
    plant.add(100)
    publisher = make_publisher(broker, plant, tmp_path / "data", first="new")
    publisher.start()
    plant.add(5)
    wait_until(lambda: len(subscriber.numbers) >= 5)
    assert subscriber.numbers == [101, 102, 103, 104, 105]
    publisher.close()
    subscriber.close()


@with_broker
def test_a_ledger_that_begins_again_is_published_whole_and_named(broker: Broker, tmp_path: Path) -> None:
    plant, subscriber, messages = FakePlant(), Subscriber(broker.port, TOPIC), []
    plant.add(30)
    settings = MqttSettings(host="127.0.0.1", port=broker.port, topic=TOPIC, first="all")
    publisher = Publisher(settings, plant, tmp_path, messages.append)
    publisher.start()
    wait_until(lambda: len(subscriber.numbers) == 30)
    plant.replace_ledger()
    wait_until(lambda: any("it was replaced" in text for text in messages))
    plant.add(2)
    wait_until(lambda: len(subscriber.numbers) == 32)
    assert subscriber.numbers[30:] == [1, 2]
    publisher.close()
    subscriber.close()


@with_broker
def test_a_wrong_password_is_named_and_nothing_is_published(tmp_path: Path) -> None:
    folder = tmp_path / "broker"
    folder.mkdir()
    (folder / "users").write_text("")
    one = Broker(folder, f"allow_anonymous false\npassword_file {folder}/users\n")
    one.start()
    messages: list[str] = []
    (tmp_path / "word").write_text("wrong\n")
    settings = MqttSettings(
        host="127.0.0.1",
        port=one.port,
        topic=TOPIC,
        user="belt",
        password_file=tmp_path / "word",
        first="all",
    )
    plant = FakePlant()
    plant.add(3)
    publisher = Publisher(settings, plant, tmp_path, messages.append)
    publisher.start()
    wait_until(lambda: bool(messages))
    assert "refused (Not authorized)" in messages[0]
    assert publisher.waiting == 3
    publisher.close()
    one.stop(kill=True)


# the library leaves the socket of a failed handshake to the garbage collector
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@with_broker
def test_tls_checks_the_certificate_of_the_broker(tmp_path: Path) -> None:
    certificate, key = make_certificate(tmp_path, "broker")
    other, _ = make_certificate(tmp_path, "other")
    folder = tmp_path / "run"
    folder.mkdir()
    one = Broker(folder, f"allow_anonymous true\ncertfile {certificate}\nkeyfile {key}\n")
    one.start()
    plant, messages = FakePlant(), []
    plant.add(40)
    for authority, expected in ((other, "certificate verify failed"), (certificate, "connected")):
        settings = MqttSettings(host="127.0.0.1", port=one.port, topic=TOPIC, tls_ca=authority, first="all")
        publisher = Publisher(settings, plant, tmp_path, messages.append)
        publisher.start()
        wait_until(lambda wanted=expected: any(wanted in text for text in messages))
        if authority is certificate:
            wait_until(lambda publisher=publisher: publisher.waiting == 0)
        assert publisher.waiting == (0 if authority is certificate else 40)
        publisher.close()
    one.stop(kill=True)


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        (MQTT_3_REFUSAL, "refused (the broker does not speak MQTT 5; update it"),
        (bytes((0x20, 3, 0, 132, 0)), "refused (the broker does not speak MQTT 5; update it"),
        (b"", "it ends without an answer; check that host and port are those of a broker that speaks MQTT 5"),
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "it ends without an answer; check that host and port are"),
    ],
)
def test_what_does_not_speak_mqtt_5_is_named(tmp_path: Path, answer: bytes, expected: str) -> None:
    messages: list[str] = []
    settings = MqttSettings(host="127.0.0.1", port=answer_every_client(answer), topic=TOPIC)
    publisher = Publisher(settings, FakePlant(), tmp_path, messages.append)
    publisher.start()
    wait_until(lambda: bool(messages))
    publisher.close()
    assert expected in messages[0]


def test_a_broker_that_is_not_there_is_named_and_closing_is_quick(tmp_path: Path) -> None:
    messages: list[str] = []
    settings = MqttSettings(host="127.0.0.1", port=find_port(), topic=TOPIC)
    publisher = Publisher(settings, FakePlant(), tmp_path, messages.append)
    publisher.start()
    wait_until(lambda: bool(messages))
    assert "not connected" in messages[0]
    start = time.monotonic()
    publisher.close()
    assert time.monotonic() - start < 3


def test_messages_hold_no_nan() -> None:
    record = json.loads(format_record(make_record(7, "degraded")))
    assert (record["number"], record["quality"], record["volume_m3"]) == (7, "uncertain", 0.0002)
    state = json.loads(format_state(FakePlant().read_state()))
    assert state["total"]["volume_m3"] == 0
    alarm = json.loads(format_alarm(FakePlant().state.alarms[0]))
    assert (alarm["value"], alarm["isa_state"], alarm["priority"], alarm["first"]) == (
        None,
        "normal",
        "medium",
        False,
    )


def test_the_cursor_survives_and_belongs_to_one_broker(tmp_path: Path) -> None:
    path = tmp_path / "mqtt.json"
    assert read_cursor(path, "one").number is None
    read_cursor(path, "one").keep(12)
    assert read_cursor(path, "one").number == 12
    assert read_cursor(path, "two").number is None


@pytest.mark.parametrize("topic", ["a/#", "+/a", "/a", "$SYS", "a/", ""])
def test_topics_that_no_broker_takes_are_refused(topic: str) -> None:
    with pytest.raises(ValidationError, match="topic"):
        MqttSettings(host="broker", topic=topic)


def test_ports_and_files_of_the_settings(tmp_path: Path) -> None:
    assert MqttSettings(host="broker").broker_port == 1883
    assert MqttSettings(host="broker", tls=True).broker_port == 8883
    with pytest.raises(ValidationError, match="tls_key is missing"):
        MqttSettings(host="broker", tls_certificate=tmp_path / "c.pem")
    with pytest.raises(InputError, match=r"nothing.pem: there is no such file"):
        check_settings(MqttSettings(host="broker", tls_ca=tmp_path / "nothing.pem"))
    with pytest.raises(InputError, match="password cannot be read"):
        check_settings(MqttSettings(host="broker", password_file=tmp_path / "nothing"))
