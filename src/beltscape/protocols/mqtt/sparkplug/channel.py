"""One session of the edge node: its birth and the device's, data, the command of rebirth, its death.

Data are published without acknowledgement, as the specification demands (quality of service 0). A subscription that
is renewed behind them is confirmed by the broker only after it has received them, so that records are known to have
arrived there; while a primary host is offline they wait.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Event

from beltscape import __version__
from beltscape.core.belt.ledger_entries import BeltRecord
from beltscape.protocols.kept_number import KeptNumber
from beltscape.protocols.mqtt.connection import Connection, Message
from beltscape.protocols.mqtt.settings import MqttSettings
from beltscape.protocols.mqtt.sparkplug.metrics import DeviceMetrics
from beltscape.protocols.mqtt.sparkplug.payload import REBIRTH, Metric, encode, is_rebirth
from beltscape.protocols.mqtt.sparkplug.primary_host import PrimaryHost
from beltscape.protocols.plant import PlantState

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
        self._death = Message(self._topic.format("NDEATH"), encode(_now_ms(), [self._make_birth_number()]))
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
        self._connection.publish(Message(self._topic.format("NBIRTH"), payload, qos=0))
        self._publish("DBIRTH", self._metrics.make_birth(state))
        self._is_born = True

    def _publish(self, kind: str, metrics: Sequence[Metric]) -> None:
        topic = f"{self._topic.format(kind)}/{self._device}"
        self._connection.publish(Message(topic, encode(_now_ms(), metrics, self._take_sequence()), qos=0))

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
