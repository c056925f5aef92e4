"""A broker (mosquitto) and a subscriber for the tests of MQTT."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import paho.mqtt.client as mqtt
import pytest
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

PROGRAM = shutil.which("mosquitto") or (
    "/usr/sbin/mosquitto" if Path("/usr/sbin/mosquitto").exists() else None
)
with_broker = pytest.mark.skipif(
    PROGRAM is None, reason="mosquitto is not installed; `make system` brings it"
)


MQTT_3_REFUSAL = bytes((0x20, 2, 0, 1))
"""CONNACK of a broker of MQTT 3.1.1 that gets a CONNECT of MQTT 5: "unacceptable protocol version"."""


def answer_every_client(answer: bytes) -> int:
    """Return the port of a thread that answers the first bytes of every client by these, and ends the connection."""
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        while True:
            with listener.accept()[0] as client:
                client.recv(4096)
                client.sendall(answer)

    threading.Thread(target=serve, daemon=True).start()
    return listener.getsockname()[1]


def find_port() -> int:
    """Return a free TCP port."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def wait_until(condition: Callable[[], bool], seconds: float = 20.0) -> None:
    """Wait for a condition; AssertionError if it does not become true."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.02)


class Broker:
    """A mosquitto on a port of this machine, which can be stopped and started again."""

    def __init__(self, folder: Path, lines: str = "allow_anonymous true\n") -> None:
        self.port = find_port()
        self.folder = folder
        self._settings = folder / "mosquitto.conf"
        self._settings.write_text(
            f"listener {self.port} 127.0.0.1\npersistence true\npersistence_location {folder}/\n"
            f"user root\n{lines}"
        )
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it and wait until it answers."""
        assert PROGRAM is not None
        with (self.folder / "log").open("ab") as log:
            self._process = subprocess.Popen([PROGRAM, "-c", str(self._settings)], stdout=log, stderr=log)
        wait_until(self._answers)

    def stop(self, *, kill: bool = False) -> None:
        """End it by SIGTERM, or by SIGKILL."""
        if self._process is not None:
            if kill:
                self._process.kill()
            else:
                self._process.terminate()
            self._process.wait()
            self._process = None

    def _answers(self) -> bool:
        with socket.socket() as one:
            return one.connect_ex(("127.0.0.1", self.port)) == 0


class Subscriber:
    """A client that keeps all messages below a topic; it has a session, so that it misses none while it is away."""

    def __init__(self, port: int, topic: str) -> None:
        self.messages: list[tuple[str, Any]] = []
        self._ready = threading.Event()
        client = mqtt.Client(CallbackAPIVersion.VERSION2, "subscriber", protocol=mqtt.MQTTv5)
        client.reconnect_delay_set(1, 1)

        def subscribe(*_: object) -> None:
            client.subscribe(f"{topic}/#", qos=1)

        client.on_connect = subscribe
        client.on_subscribe = lambda *_: self._ready.set()
        client.on_message = lambda _client, _data, message: self._keep(message)
        properties = Properties(PacketTypes.CONNECT)
        properties.SessionExpiryInterval = 3600
        client.connect("127.0.0.1", port, clean_start=False, properties=properties)
        client.loop_start()
        self._client = client
        assert self._ready.wait(10)

    @property
    def numbers(self) -> list[int]:
        """Return the numbers of the records in the order of their arrival."""
        return [message["number"] for topic, message in list(self.messages) if topic.endswith("/records")]

    def last(self, name: str) -> Any:
        """Return the newest message of a topic; None if there was none."""
        found = [message for topic, message in list(self.messages) if topic.endswith(f"/{name}")]
        return found[-1] if found else None

    def close(self) -> None:
        """Disconnect."""
        self._client.disconnect()
        self._client.loop_stop()

    def _keep(self, message: mqtt.MQTTMessage) -> None:
        text = message.payload.decode("utf-8")
        self.messages.append((message.topic, json.loads(text) if text[:1] == "{" else text))
