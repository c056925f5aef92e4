"""One connection to the broker."""

from __future__ import annotations

import threading
from contextlib import suppress
from pathlib import Path
from time import monotonic
from typing import Any

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.reasoncodes import ReasonCode

from beltscape.protocols.client_tls import make_client_context
from beltscape.protocols.mqtt.settings import MqttSettings

_ACKNOWLEDGED_S = 20.0
"""Time for the acknowledgement of a batch, after which the connection is made anew. Chosen."""
_CONNECT_S = 10.0
"""Time for a connection to be accepted. Chosen."""
_POLL_S = 0.1
"""Interval at which a lost connection is noticed while acknowledgements are awaited. Chosen."""
_KEEP_ALIVE_S = 15
"""One and a half times this silence is a broken connection to the broker. Chosen."""


class Connection:
    """One connection to the broker; after it is lost a new one is made, so that nothing is sent twice by itself."""

    def __init__(self, settings: MqttSettings, password: str | None) -> None:
        self._settings = settings
        self._answered, self._lost = threading.Event(), threading.Event()
        self.reason = ""
        client = mqtt.Client(CallbackAPIVersion.VERSION2, settings.client_id, protocol=mqtt.MQTTv5)
        client.max_queued_messages_set(0)
        if settings.user:
            client.username_pw_set(settings.user, password)
        if settings.is_encrypted:
            files = settings.tls_ca, settings.tls_certificate, settings.tls_key
            client.tls_set_context(make_client_context(*files))  # pyright: ignore[reportUnknownMemberType]
        client.will_set(f"{settings.topic}/status", "offline", qos=1, retain=True)
        client.on_connect, client.on_disconnect = self._on_connect, self._on_disconnect
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
            return f"not connected ({error})"
        self._client.loop_start()
        if not self._answered.wait(_CONNECT_S):
            return self.reason or "not connected (no answer)"
        if not self.is_up:
            return self.reason
        self._client.publish(f"{self._settings.topic}/status", "online", qos=1, retain=True)
        return ""

    def publish_retained(self, name: str, text: str) -> None:
        """Publish a message that the broker keeps for those who come later; it may be lost."""
        self._client.publish(f"{self._settings.topic}/{name}", text, qos=0, retain=True)

    def publish_all(self, messages: list[tuple[str, str]]) -> int:
        """Publish messages; return how many of them, from the first on, the broker has acknowledged."""
        sent = [
            self._client.publish(f"{self._settings.topic}/{name}", text, qos=1) for name, text in messages
        ]
        deadline_s = monotonic() + _ACKNOWLEDGED_S
        for i, message in enumerate(sent):
            while not message.is_published():
                if self._lost.is_set() or monotonic() > deadline_s:
                    self._lose("the broker does not acknowledge records")
                    return i
                try:
                    message.wait_for_publish(_POLL_S)
                except (RuntimeError, ValueError) as error:
                    self._lose(str(error))
                    return i
        return len(sent)

    def close(self) -> None:
        """Say goodbye where the connection still stands, and end the library's thread."""
        if self.is_up:
            goodbye = self._client.publish(f"{self._settings.topic}/status", "offline", qos=1, retain=True)
            with suppress(RuntimeError, ValueError):
                goodbye.wait_for_publish(1.0)
        self._client.disconnect()
        self._client.loop_stop()

    def _on_connect(
        self,
        _client: mqtt.Client,
        _data: Any,
        _flags: mqtt.ConnectFlags,
        reason: ReasonCode,
        _properties: Any,
    ) -> None:
        if reason.is_failure:
            self._lose(f"refused ({reason})")
        self._answered.set()

    def _on_disconnect(
        self,
        _client: mqtt.Client,
        _data: Any,
        _flags: mqtt.DisconnectFlags,
        reason: ReasonCode,
        _properties: Any,
    ) -> None:
        self._lose(f"connection lost ({reason})")
        self._answered.set()

    def _lose(self, reason: str) -> None:
        self.reason = self.reason or reason
        self._lost.set()


def list_tls_files(settings: MqttSettings) -> tuple[Path | None, Path | None, Path | None]:
    """Return the files of the authority, the client's certificate and its key."""
    return settings.tls_ca, settings.tls_certificate, settings.tls_key
