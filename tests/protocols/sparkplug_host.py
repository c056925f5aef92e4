"""A Sparkplug host for the tests: a decoder of the wire format of its own, and a host application's checks."""

from __future__ import annotations

import json
import struct
import threading
import time
from collections.abc import Iterator
from typing import Any

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

METRIC = {
    1: "name",
    2: "alias",
    3: "timestamp",
    4: "datatype",
    5: "is_historical",
    7: "is_null",
    9: "properties",
}
TYPES = {3: "Int32", 4: "Int64", 8: "UInt64", 10: "Double", 11: "Boolean", 12: "String"}


def read_varint(data: bytes, at: int) -> tuple[int, int]:
    """Return an integer and the place behind it."""
    value = shift = 0
    while True:
        byte = data[at]
        at += 1
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            return value, at


def read_fields(data: bytes) -> Iterator[tuple[int, int, Any]]:
    """Yield number, wire type and value of every field of a protocol buffer."""
    at = 0
    while at < len(data):
        key, at = read_varint(data, at)
        number, wire = key >> 3, key & 7
        if wire == 0:
            value, at = read_varint(data, at)
        else:
            size = {1: 8, 5: 4}.get(wire)
            if size is None:
                assert wire == 2
                size, at = read_varint(data, at)
            value, at = data[at : at + size], at + size
        yield number, wire, value


def decode(data: bytes) -> dict[str, Any]:
    """Return timestamp, seq and metrics of a payload, by the numbers of the specification, §6.4."""
    payload: dict[str, Any] = {"metrics": [], "seq": None, "timestamp": None}
    for number, _, value in read_fields(data):
        if number == 2:
            payload["metrics"].append(_decode_metric(value))
        else:
            payload[{1: "timestamp", 3: "seq"}[number]] = value
    return payload


def _decode_metric(data: bytes) -> dict[str, Any]:
    metric: dict[str, Any] = {"value": None, "properties": {}, "alias": None, "name": ""}
    for number, _, value in read_fields(data):
        if number == 9:
            metric["properties"] = _decode_properties(value)
        elif number in METRIC:
            metric[METRIC[number]] = value.decode() if number == 1 else value
        elif number in (10, 11):
            metric["value"] = value
        elif number == 13:
            metric["value"] = struct.unpack("<d", value)[0]
        elif number == 14:
            metric["value"] = bool(value)
        elif number == 15:
            metric["value"] = value.decode()
    metric["type"] = TYPES[metric["datatype"]]
    bits = {"Int32": 32, "Int64": 64}.get(metric["type"])
    value: Any = metric["value"]
    if bits and value is not None and value >> (bits - 1):
        metric["value"] = value - (1 << bits)
    return metric


def _decode_properties(data: bytes) -> dict[str, Any]:
    keys: list[str] = []
    values: list[Any] = []
    for number, _, value in read_fields(data):
        if number == 1:
            keys.append(value.decode())
        else:
            fields = {field: part for field, _, part in read_fields(value)}
            values.append(fields[8].decode() if 8 in fields else fields.get(3))
    return dict(zip(keys, values, strict=True))


class Host:
    """A host application: it keeps births, resolves aliases, and collects what breaks the rules in ``wrong``."""

    def __init__(self, port: int, name: str = "") -> None:
        self.messages: list[tuple[str, dict[str, Any], int, bool]] = []
        self.records: list[dict[str, Any]] = []
        self.historical: list[bool] = []
        self.values: dict[str, Any] = {}
        self.births: list[int] = []
        self.deaths: list[int] = []
        self.wrong: list[str] = []
        self._seq: int | None = None
        self._names: dict[int, str] = {}
        self._ready, self.name = threading.Event(), name
        client = mqtt.Client(CallbackAPIVersion.VERSION2, f"host-{port}-{name}", protocol=mqtt.MQTTv5)
        client.reconnect_delay_set(1, 1)

        def subscribe(*_: object) -> None:
            client.subscribe("spBv1.0/plant/#", qos=1)

        client.on_connect = subscribe
        client.on_subscribe = lambda *_: self._on_subscribed()
        client.on_message = lambda _client, _data, message: self._take(message)
        if name:
            client.will_set(f"spBv1.0/STATE/{name}", self._make_state(online=False), 1, True)
        client.connect("127.0.0.1", port)
        client.loop_start()
        self._client = client
        assert self._ready.wait(10)

    @property
    def numbers(self) -> list[int]:
        """Return the numbers of the records in the order of their arrival."""
        return [record["Record/Number"] for record in list(self.records)]

    def set_online(self, *, online: bool) -> None:
        """Say whether this host is online."""
        self._client.publish(
            f"spBv1.0/STATE/{self.name}", self._make_state(online=online), 1, True
        ).wait_for_publish(5)

    def is_connected(self) -> bool:
        """Return whether the connection to the broker stands."""
        return self._client.is_connected()

    def send(self, data: bytes) -> None:
        """Send a command to the node."""
        self._client.publish("spBv1.0/plant/NCMD/tower", data, 0)

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()

    def _make_state(self, *, online: bool) -> str:
        return json.dumps({"online": online, "timestamp": time.time_ns() // 1_000_000})

    def _on_subscribed(self) -> None:
        self._seq = None
        self._ready.set()

    def _take(self, message: mqtt.MQTTMessage) -> None:
        _, _, kind, *_ = message.topic.split("/")
        if kind in ("NCMD", "STATE"):
            return
        payload = decode(bytes(message.payload))
        self.messages.append((message.topic, payload, message.qos, message.retain))
        values = {metric["name"]: metric["value"] for metric in payload["metrics"]}
        if kind == "NDEATH":
            self.deaths.append(values["bdSeq"])
            self._seq = None
            return
        if kind == "NBIRTH":
            self.births.append(values["bdSeq"])
            self._names.clear()
            self._check(payload["seq"] == 0, f"NBIRTH has seq {payload['seq']}")
        elif self._seq is not None:
            self._check(
                payload["seq"] == (self._seq + 1) % 256, f"{kind}: seq {payload['seq']} behind {self._seq}"
            )
        self._seq = payload["seq"]
        if message.topic.endswith("/belt"):
            self._take_device(kind, payload)

    def _take_device(self, kind: str, payload: dict[str, Any]) -> None:
        found: dict[str, Any] = {}
        for metric in payload["metrics"]:
            if kind == "DBIRTH":
                self._names[metric["alias"]] = metric["name"]
            self._check(metric["alias"] in self._names, f"alias {metric['alias']} was not born")
            found[self._names.get(metric["alias"], "?")] = metric["value"]
        if kind == "DDATA" and "Record/Number" in found:
            self.records.append(found)
            self.historical.append(any(metric.get("is_historical") for metric in payload["metrics"]))
        self.values.update(found)

    def _check(self, is_right: bool, wrong: str) -> None:
        if not is_right:
            self.wrong.append(wrong)
