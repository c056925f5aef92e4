"""One connection to the broker."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Any

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from beltscape.core.errors import describe_cause
from beltscape.protocols.client_tls import make_client_context
from beltscape.protocols.settings import MqttSettings

_ACKNOWLEDGED_S = 20.0
"""Time for the acknowledgement of a batch, after which the connection is made anew. Chosen."""
_CONNECT_S = 10.0
"""Time for a connection to be accepted. Chosen."""
_POLL_S = 0.1
"""Interval at which a lost connection is noticed while acknowledgements are awaited. Chosen."""
_KEEP_ALIVE_S = 15
"""One and a half times this silence is a broken connection to the broker. Chosen."""
_OLD_BROKER = (
    "the broker does not speak MQTT 5; update it (Mosquitto since 1.6, RabbitMQ since 3.13) or use another"
)
_NO_ANSWER = "check that host and port are those of a broker that speaks MQTT 5, and whether it wants TLS"
_OLD_PROTOCOL = 132
"""Reason "unsupported protocol version" (MQTT 5, 3.2.2.2); paho makes it of the 1 that brokers of 3.1.1 answer."""


@dataclass(frozen=True, slots=True)
class MqttMessage:
    """A message to publish."""

    topic: str
    payload: str | bytes
    qos: int = 1
    """1: the broker acknowledges it; 0: it does not."""
    retain: bool = False
    """Whether the broker keeps it for those who come later."""


class Connection:
    """One connection to the broker; after it is lost a new one is made, so that nothing is sent twice by itself."""

    def __init__(
        self,
        settings: MqttSettings,
        password: str | None,
        will: MqttMessage,
        on_message: Callable[[str, bytes], None] = lambda _topic, _payload: None,
    ) -> None:
        """Prepare; the broker publishes ``will`` if the connection breaks; ``on_message`` gets topic and payload."""
        self._settings = settings
        self._answered, self._lost = threading.Event(), threading.Event()
        self._subscribed: set[int | None] = set()
        self._subscription = threading.Condition()
        self.reason = ""
        client = mqtt.Client(CallbackAPIVersion.VERSION2, settings.client_id, protocol=mqtt.MQTTv5)
        client.max_queued_messages_set(0)
        if settings.user:
            client.username_pw_set(settings.user, password)
        if settings.is_encrypted:
            files = settings.tls_ca, settings.tls_certificate, settings.tls_key
            client.tls_set_context(make_client_context(*files))
        client.will_set(will.topic, will.payload, qos=will.qos, retain=will.retain)
        client.on_connect, client.on_disconnect = self._on_connect, self._on_disconnect
        client.on_subscribe = self._on_subscribe
        client.on_message = lambda _client, _data, message: on_message(message.topic, bytes(message.payload))
        self._client = client

    @property
    def is_up(self) -> bool:
        """Return whether the broker has accepted the connection and it is not lost."""
        return self._answered.is_set() and not self._lost.is_set()

    def open(self) -> str:
        """Connect; return why that failed, or an empty text."""
        try:
            self._client.connect(
                self._settings.host, self._settings.broker_port, _KEEP_ALIVE_S, clean_start=True
            )
        except OSError as error:
            return f"not connected ({describe_cause(error)})"
        self._client.loop_start()
        if not self._answered.wait(_CONNECT_S):
            return self.reason or f"not connected (no answer; {_NO_ANSWER})"
        return "" if self.is_up else self.reason

    def subscribe(self, topics: Sequence[str], *, retained: bool = True) -> bool:
        """Subscribe, and wait until the broker has confirmed it; return whether it has.

        The broker confirms in the order in which it was sent messages, so that it has received all earlier ones then.
        ``retained``: whether it sends the messages that it keeps of these topics.
        """
        handling = (
            SubscribeOptions.RETAIN_SEND_ON_SUBSCRIBE if retained else SubscribeOptions.RETAIN_DO_NOT_SEND
        )
        options = SubscribeOptions(qos=1, retainHandling=handling)
        _, number = self._client.subscribe([(topic, options) for topic in topics])
        deadline_s = monotonic() + _ACKNOWLEDGED_S
        with self._subscription:
            while number not in self._subscribed:
                if self._lost.is_set() or monotonic() > deadline_s:
                    self.lose("the broker does not confirm a subscription")
                    return False
                self._subscription.wait(_POLL_S)
            self._subscribed.discard(number)
        return True

    def publish(self, message: MqttMessage) -> None:
        """Publish a message without waiting; it may be lost."""
        self._client.publish(message.topic, message.payload, message.qos, message.retain)

    def publish_all(self, messages: Sequence[MqttMessage]) -> int:
        """Publish messages; return how many of them, from the first on, the broker has acknowledged."""
        sent = [self._client.publish(one.topic, one.payload, one.qos, one.retain) for one in messages]
        deadline_s = monotonic() + _ACKNOWLEDGED_S
        for i, message in enumerate(sent):
            while not message.is_published():
                if self._lost.is_set() or monotonic() > deadline_s:
                    self.lose("the broker does not acknowledge records")
                    return i
                try:
                    message.wait_for_publish(_POLL_S)
                except (RuntimeError, ValueError) as error:
                    self.lose(str(error))
                    return i
        return len(sent)

    def lose(self, reason: str) -> None:
        """Count the connection as lost."""
        self.reason = self.reason or reason
        self._lost.set()

    def close(self, goodbye: MqttMessage | None) -> None:
        """Publish ``goodbye``, if there is one, where the connection still stands, and end the library's thread."""
        if goodbye is not None and self._client.is_connected():
            sent = self._client.publish(goodbye.topic, goodbye.payload, goodbye.qos, goodbye.retain)
            with suppress(RuntimeError, ValueError):
                sent.wait_for_publish(1.0)
        self._client.disconnect()
        self._client.loop_stop()

    def _on_subscribe(
        self,
        _client: mqtt.Client,
        _data: Any,
        number: int,
        reasons: list[ReasonCode],
        _properties: Any,
    ) -> None:
        if any(reason.is_failure for reason in reasons):
            self.lose(f"subscription refused ({reasons[0]})")
        with self._subscription:
            self._subscribed.add(number)
            self._subscription.notify_all()

    def _on_connect(
        self,
        _client: mqtt.Client,
        _data: Any,
        _flags: mqtt.ConnectFlags,
        reason: ReasonCode,
        _properties: Any,
    ) -> None:
        if reason.is_failure:
            self.lose(f"refused ({_OLD_BROKER if reason == _OLD_PROTOCOL else reason})")
        self._answered.set()

    def _on_disconnect(
        self,
        _client: mqtt.Client,
        _data: Any,
        _flags: mqtt.DisconnectFlags,
        reason: ReasonCode,
        _properties: Any,
    ) -> None:
        lost = f"connection lost ({reason})"
        self.lose(
            lost if self._answered.is_set() else f"not connected (it ends without an answer; {_NO_ANSWER})"
        )
        self._answered.set()


def list_tls_files(settings: MqttSettings) -> tuple[Path | None, Path | None, Path | None]:
    """Return the files of the authority, the client's certificate and its key."""
    return settings.tls_ca, settings.tls_certificate, settings.tls_key


def find_refusal(settings: MqttSettings, password: str | None) -> str:
    """Return why the broker does not accept a connection, in one line; empty if it does. Nothing is published."""
    # another identifier, since a broker disconnects the running client where one comes with its own; at most 60 long
    own = settings.model_copy(update={"client": f"{settings.client_id[:50]}-check"})
    connection = Connection(own, password, MqttMessage(f"{settings.place}/check", "", qos=0))
    try:
        return connection.open()
    finally:
        connection.close(None)
