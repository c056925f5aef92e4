"""JSON: records, state and alarms below one topic, and whether the program is online."""

from __future__ import annotations

from collections.abc import Sequence

from beltscape.core.belt.ledger_entries import BeltRecord
from beltscape.protocols.mqtt.connection import Connection, Message
from beltscape.protocols.mqtt.payloads import format_alarm, format_record, format_state
from beltscape.protocols.mqtt.settings import MqttSettings
from beltscape.protocols.plant import PlantState


class JsonChannel:
    """One session with the broker; see ``publisher.Channel``."""

    needs_state = False
    republish_after: int | None = None

    def __init__(self, settings: MqttSettings, password: str | None) -> None:
        self._topic = settings.topic
        self._connection = Connection(settings, password, self._make_status("offline"))
        self._alarms: dict[str, str] = {}

    @property
    def is_up(self) -> bool:
        """Return whether the connection stands."""
        return self._connection.is_up

    @property
    def reason(self) -> str:
        """Return why it was lost."""
        return self._connection.reason

    def open(self) -> str:
        """Connect; return why that failed, or an empty text."""
        trouble = self._connection.open()
        if not trouble:
            self._connection.publish(self._make_status("online"))
        return trouble

    def publish_state(self, state: PlantState) -> None:
        """Publish the state, and the alarms that have changed; the broker keeps them."""
        self._connection.publish(Message(f"{self._topic}/state", format_state(state), qos=0, retain=True))
        for alarm in state.alarms:
            text = format_alarm(alarm)
            if self._alarms.get(alarm.name) != text:
                self._alarms[alarm.name] = text
                topic = f"{self._topic}/alarms/{alarm.name.replace(':', '/')}"
                self._connection.publish(Message(topic, text, qos=0, retain=True))

    def publish_records(self, records: Sequence[BeltRecord]) -> int:
        """Publish records; return how many of them, from the first on, have arrived."""
        return self._connection.publish_all(
            [Message(f"{self._topic}/records", format_record(record)) for record in records]
        )

    def close(self) -> None:
        """Say goodbye where the connection still stands, and end."""
        self._connection.close(self._make_status("offline"))

    def _make_status(self, text: str) -> Message:
        return Message(f"{self._topic}/status", text, retain=True)
