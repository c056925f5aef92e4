"""Sparkplug B 3.0 (https://sparkplug.eclipse.org/specification): the belt as a device of an edge node.

A session of the node has its birth and the device's, data, the command of rebirth, and its death. The metrics of the
device are the present state, the alarms and the newest record of the belt.

Data are published without acknowledgement, as the specification demands (quality of service 0). A subscription that
is renewed behind them is confirmed by the broker only after it has received them, so that records are known to have
arrived there; while a primary host is offline they wait at the belt (§5.4 and §5.13).
"""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isnan, nan
from pathlib import Path
from threading import Event
from time import monotonic

from beltscape import __version__
from beltscape.core.checks import is_dict
from beltscape.core.ledger import BeltRecord
from beltscape.protocols.kept_number import KeptNumber
from beltscape.protocols.mqtt.connection import Connection, MqttMessage
from beltscape.protocols.mqtt.json_channel import QUALITIES
from beltscape.protocols.mqtt.sparkplug_payload import (
    BAD,
    GOOD,
    REBIRTH,
    DataType,
    Metric,
    Value,
    encode,
    is_rebirth,
)
from beltscape.protocols.plant import PlantState
from beltscape.protocols.settings import MqttSettings

_MS_NS = 1_000_000
"""Nanoseconds of a millisecond."""
HISTORICAL_MS = 10_000
"""A record that is published later than this after it was measured is historical: hosts store it. Chosen."""


@dataclass(frozen=True, slots=True)
class StateMetric:
    """A metric of the present state."""

    type: DataType
    unit: str
    read: Callable[[PlantState], Value]
    is_measured: bool = False
    """Whether it is bad while nothing is measured."""


@dataclass(frozen=True, slots=True)
class RecordMetric:
    """A metric of a record."""

    type: DataType
    unit: str
    read: Callable[[BeltRecord], Value]


STATE: Mapping[str, StateMetric] = {
    "Flow/Volume": StateMetric("Double", "m³/h", lambda s: s.volume_flow_m3_h, is_measured=True),
    "Flow/Volume Sigma": StateMetric("Double", "m³/h", lambda s: s.volume_flow_sigma_m3_h, is_measured=True),
    "Flow/Mass": StateMetric("Double", "t/h", lambda s: s.mass_flow_t_h, is_measured=True),
    "Flow/Mass Sigma": StateMetric("Double", "t/h", lambda s: s.mass_flow_sigma_t_h, is_measured=True),
    "Flow/Quality": StateMetric("String", "", lambda s: QUALITIES[s.standing]),
    "Load/Area": StateMetric("Double", "m²", lambda s: s.area_mm2 * 1e-6, is_measured=True),
    "Load/Coverage": StateMetric("Double", "", lambda s: s.coverage, is_measured=True),
    "Belt/Speed": StateMetric("Double", "m/s", lambda s: s.speed_m_s),
    "Total/Volume": StateMetric("Double", "m³", lambda s: s.totals.volume_mm3 * 1e-9),
    "Total/Volume Sigma": StateMetric("Double", "m³", lambda s: s.totals.sigma_mm3 * 1e-9),
    "Total/Mass": StateMetric("Double", "t", lambda s: s.totals.mass_kg * 1e-3),
    "Total/Valid": StateMetric("Double", "m", lambda s: s.totals.valid_mm * 1e-3),
    "Total/Degraded": StateMetric("Double", "m", lambda s: s.totals.degraded_mm * 1e-3),
    "Total/Missing": StateMetric("Double", "m", lambda s: s.totals.missing_mm * 1e-3),
    "Cameras/All": StateMetric("Int32", "", lambda s: len(s.cameras)),
    "Cameras/OK": StateMetric("Int32", "", lambda s: sum(camera.state == "ok" for camera in s.cameras)),
    "Production/Product": StateMetric("String", "", lambda s: s.product),
    "Production/Batch": StateMetric("String", "", lambda s: s.batch),
    "Maintenance": StateMetric("String", "", lambda s: s.maintenance),
}
"""By name: the metrics of the present state."""
RECORD: Mapping[str, RecordMetric] = {
    "Record/Number": RecordMetric("UInt64", "", lambda r: r.number),
    "Record/Run": RecordMetric("Int64", "", lambda r: r.run),
    "Record/From": RecordMetric("Double", "m", lambda r: r.belt_mm[0] * 1e-3),
    "Record/To": RecordMetric("Double", "m", lambda r: r.belt_mm[1] * 1e-3),
    "Record/Standing": RecordMetric("String", "", lambda r: r.standing),
    "Record/Quality": RecordMetric("String", "", lambda r: QUALITIES[r.standing]),
    "Record/Reason": RecordMetric("String", "", lambda r: r.reason),
    "Record/Volume": RecordMetric("Double", "m³", lambda r: r.volume_mm3 * 1e-9),
    "Record/Sigma": RecordMetric("Double", "m³", lambda r: r.sigma_mm3 * 1e-9),
    "Record/Mass": RecordMetric("Double", "t", lambda r: r.mass_kg * 1e-3),
    "Record/Flow": RecordMetric(
        "Double", "m³/h", lambda r: nan if r.strip is None else r.strip.volume_flow_m3_h
    ),
    "Record/Speed": RecordMetric(
        "Double", "m/s", lambda r: nan if r.strip is None else r.strip.speed_mm_s * 1e-3
    ),
    "Record/Coverage": RecordMetric("Double", "", lambda r: nan if r.strip is None else r.strip.coverage),
    "Record/Cameras": RecordMetric("Int32", "", lambda r: r.cameras),
}
"""By name: the metrics of a record; one message holds those of one record."""
ALARMS = "Alarms/"
"""Begin of the names of alarms, whose values are clear, raised, acknowledged, gone and the like."""
_Sent = tuple[Value, int | None]


class DeviceMetrics:
    """The metrics with their aliases, and what was sent of them, so that data hold changes only."""

    def __init__(self) -> None:
        self._aliases: dict[str, int] = {}
        self._sent: dict[str, _Sent] = {}

    def knows_alarms(self, state: PlantState) -> bool:
        """Return whether the last birth had all alarms of the state; otherwise another birth is due."""
        return all(f"{ALARMS}{alarm.name}" in self._aliases for alarm in state.alarms)

    def make_birth(self, state: PlantState) -> list[Metric]:
        """Return all metrics with names, aliases, units and qualities; those of records are not known yet."""
        time_ms = state.wall_ns // _MS_NS
        self._sent.clear()
        metrics = [
            self._name(name, metric.unit, self._make(name, metric.type, value, quality, time_ms))
            for name, metric, value, quality in _list_state(state)
        ]
        return metrics + [
            Metric(metric.type, None, time_ms, name, self._get_alias(name), quality=BAD, unit=metric.unit)
            for name, metric in RECORD.items()
        ]

    def make_changes(self, state: PlantState) -> list[Metric]:
        """Return the metrics of the state that differ from what was sent."""
        time_ms = state.wall_ns // _MS_NS
        return [
            self._make(name, metric.type, value, quality, time_ms)
            for name, metric, value, quality in _list_state(state)
            if not _is_same(self._sent.get(name), (value, quality))
        ]

    def make_record(self, record: BeltRecord, now_ms: int) -> list[Metric]:
        """Return the metrics of a record, historical where it is published late."""
        time_ms = record.wall_ns // _MS_NS
        is_late = now_ms - time_ms > HISTORICAL_MS
        quality = BAD if record.standing == "missing" else GOOD
        return [
            Metric(
                metric.type,
                metric.read(record),
                time_ms,
                alias=self._get_alias(name),
                is_historical=is_late,
                quality=quality,
            )
            for name, metric in RECORD.items()
        ]

    def _make(self, name: str, kind: DataType, value: Value, quality: int, time_ms: int) -> Metric:
        before = self._sent.get(name)
        self._sent[name] = value, quality
        is_new = before is None or before[1] != quality
        alias = self._get_alias(name)
        return Metric(kind, value, time_ms, alias=alias, quality=quality if is_new else None)

    def _name(self, name: str, unit: str, metric: Metric) -> Metric:
        return Metric(
            metric.type,
            metric.value,
            metric.timestamp_ms,
            name,
            metric.alias,
            quality=metric.quality,
            unit=unit,
        )

    def _get_alias(self, name: str) -> int:
        return self._aliases.setdefault(name, len(self._aliases) + 1)


_ALARM = StateMetric("String", "", lambda _: "")


def _list_state(state: PlantState) -> list[tuple[str, StateMetric, Value, int]]:
    """Return name, metric, value and quality of the state's metrics and alarms."""
    found: list[tuple[str, StateMetric, Value, int]] = []
    for name, metric in STATE.items():
        value = metric.read(state)
        is_bad = _is_nan(value) or (metric.is_measured and state.standing == "missing")
        found.append((name, metric, value, BAD if is_bad else GOOD))
    return found + [(f"{ALARMS}{alarm.name}", _ALARM, alarm.state, GOOD) for alarm in state.alarms]


def _is_same(one: _Sent | None, other: _Sent) -> bool:
    """Return whether value and quality agree; a value that is not known equals another one."""
    if one is None or one[1] != other[1]:
        return False
    return one[0] == other[0] or (_is_nan(one[0]) and _is_nan(other[0]))


def _is_nan(value: Value) -> bool:
    return isinstance(value, float) and isnan(value)


_NOTICED_S = 60.0
"""Time within which a broker notices that a host is gone: 1.5 times its keep-alive. Chosen: hosts have 30 s."""


class PrimaryHost:
    """State of the host: online or not, and the records that it may have missed before its death was noticed."""

    def __init__(self, name: str) -> None:
        """``name``: the host's identifier; empty: there is no primary host, and data never wait."""
        self.topics = (f"spBv1.0/STATE/{name}", f"STATE/{name}") if name else ()
        self.is_online = not name
        self.was_lost = False
        """Whether it was online and is not any more."""
        self._timestamp = -1.0
        self._published: deque[tuple[float, int]] = deque()

    def handle(self, topic: str, data: bytes) -> None:
        """Take a state: JSON {"online", "timestamp"}, or ONLINE and OFFLINE as in version 2.2; others are ignored."""
        if topic not in self.topics:
            return
        text = data[:1000].decode("utf-8", "replace").strip()
        if text in ("ONLINE", "OFFLINE"):
            self._set(is_online=text == "ONLINE")
            return
        try:
            state: object = json.loads(text)
        except ValueError:
            return
        if not is_dict(state) or not isinstance(state.get("online"), bool):
            return
        timestamp = state.get("timestamp")
        if not isinstance(timestamp, int | float) or timestamp < self._timestamp:
            return  # the death of an earlier session, which the broker sends late
        self._timestamp = timestamp
        self._set(is_online=state["online"] is True)

    def _set(self, *, is_online: bool) -> None:
        self.was_lost = self.was_lost or (self.is_online and not is_online)
        self.is_online = is_online

    def note_published(self, before: int) -> None:
        """Note that the records behind number ``before`` were published now."""
        now_s = monotonic()
        self._published.append((now_s, before))
        while self._published[0][0] < now_s - _NOTICED_S:
            self._published.popleft()

    @property
    def missed_after(self) -> int | None:
        """Return the number behind which the host may have missed records; None: it has missed none."""
        return self._published[0][1] if self.was_lost and self._published else None


_SEQUENCE = 256
"""Sequence numbers and numbers of births count from 0 to 255 (specification, §6.4.4 and §6.4.7)."""


class SparkplugChannel:
    """One session with the broker; see ``publisher.Channel``."""

    def __init__(
        self,
        settings: MqttSettings,
        password: str | None,
        data: Path,
        on_message: Callable[[str], object] = lambda _: None,
    ) -> None:
        """Take the next number of births, which is kept in ``data``; OutputError if it cannot be kept."""
        own = settings.sparkplug
        self._topic = f"spBv1.0/{own.group}/{{}}/{own.node}"
        self._device = own.device
        self._host = PrimaryHost(own.primary_host)
        path, key = data / "mqtt_births.json", ("node", self._topic)
        kept = KeptNumber(path, "beltscape-births/1", "birth", key, "births begin at 0", on_message)
        self._birth = (-1 if kept.number is None else kept.number) + 1
        self._birth %= _SEQUENCE
        kept.keep(self._birth)
        self._death = MqttMessage(
            self._topic.format("NDEATH"), encode(_now_ms(), [self._make_birth_number()])
        )
        self._commands = self._topic.format("NCMD")
        self._connection = Connection(settings, password, self._death, self._on_message)
        self._metrics, self._rebirth = DeviceMetrics(), Event()
        self._is_born = False
        self._sequence = 0

    @property
    def is_up(self) -> bool:
        """Return whether the connection stands; one whose primary host has gone offline is given up."""
        if self._host.was_lost:
            self._connection.lose("the primary host is offline; records wait")
        return self._connection.is_up

    @property
    def reason(self) -> str:
        """Return why it was lost."""
        return self._connection.reason

    @property
    def needs_state(self) -> bool:
        """Return whether a birth is due."""
        return self._host.is_online and (self._rebirth.is_set() or not self._is_born)

    @property
    def republish_after(self) -> int | None:
        """Return the number behind which the primary host may have missed records; None: it has missed none."""
        return self._host.missed_after

    def open(self) -> str:
        """Connect and subscribe to commands; return why that failed, or an empty text."""
        trouble = self._connection.open()
        if trouble:
            return trouble
        is_ready = self._connection.subscribe([self._commands, *self._host.topics])
        return "" if is_ready else self._connection.reason

    def publish_state(self, state: PlantState) -> None:
        """Publish births where they are due, otherwise the values that have changed; nothing without the host."""
        if not self._host.is_online:
            return
        if not self._is_born or self._rebirth.is_set():
            self._rebirth.clear()
            self._publish_births(state)
        elif not self._metrics.knows_alarms(state):
            self._publish("DBIRTH", self._metrics.make_birth(state))
        elif changes := self._metrics.make_changes(state):
            self._publish("DDATA", changes)

    def publish_records(self, records: Sequence[BeltRecord]) -> int:
        """Publish records, one message each; return how many of them, from the first on, have arrived."""
        if not self._is_born or not self._host.is_online or self._rebirth.is_set() or not records:
            return 0
        self._host.note_published(records[0].number - 1)
        for record in records:
            self._publish("DDATA", self._metrics.make_record(record, _now_ms()))
        has_arrived = self._connection.subscribe([self._commands], retained=False)
        return len(records) if has_arrived and self._host.is_online else 0

    def close(self) -> None:
        """Publish the death where the connection still stands, and end."""
        self._connection.close(self._death)

    def _publish_births(self, state: PlantState) -> None:
        self._sequence = 0
        time_ms = _now_ms()
        node = [
            self._make_birth_number(),
            Metric("Boolean", False, time_ms, REBIRTH),
            Metric("String", f"Beltscape {__version__}", time_ms, "Properties/Program"),
        ]
        payload = encode(time_ms, node, self._take_sequence())
        self._connection.publish(MqttMessage(self._topic.format("NBIRTH"), payload, qos=0))
        self._publish("DBIRTH", self._metrics.make_birth(state))
        self._is_born = True

    def _publish(self, kind: str, metrics: Sequence[Metric]) -> None:
        topic = f"{self._topic.format(kind)}/{self._device}"
        self._connection.publish(MqttMessage(topic, encode(_now_ms(), metrics, self._take_sequence()), qos=0))

    def _take_sequence(self) -> int:
        number = self._sequence
        self._sequence = (number + 1) % _SEQUENCE
        return number

    def _make_birth_number(self) -> Metric:
        return Metric("Int64", self._birth, _now_ms(), "bdSeq")

    def _on_message(self, topic: str, data: bytes) -> None:
        if topic != self._commands:
            self._host.handle(topic, data)
        elif is_rebirth(data):
            self._rebirth.set()


def _now_ms() -> int:
    return time.time_ns() // 1_000_000
