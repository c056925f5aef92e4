"""The publisher: a thread that keeps a connection to the broker and publishes every record at least once, in order.

The ledger is the outbox: records wait in the historian's database, and the cursor on the disk says which have arrived
at the broker. After a lost connection, a restart or a kill, publishing goes on behind the cursor; a record that may
have arrived or not comes again, with the same number. A channel is one session with the broker in one form of
messages: `json_channel` or `sparkplug`.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from time import monotonic
from typing import Protocol

from beltscape.core.errors import InputError, OutputError, describe_cause
from beltscape.core.ledger import BeltRecord
from beltscape.core.supervision import make_supervised_thread
from beltscape.protocols.kept_number import KeptNumber
from beltscape.protocols.mqtt.connection import list_tls_files
from beltscape.protocols.mqtt.json_channel import JsonChannel
from beltscape.protocols.plant import Plant, PlantState
from beltscape.protocols.settings import MqttSettings

_BATCH = 200
"""Records that wait for their acknowledgement at once; the broker's own limit is respected by the library."""
_PAUSES_S = (1.0, 2.0, 5.0, 10.0, 30.0)
"""Pauses between attempts to connect; the last one repeats."""
_POLL_S = 0.1
"""Interval at which new records are looked for."""


class Channel(Protocol):
    """One session with the broker."""

    @property
    def is_up(self) -> bool:
        """Return whether the connection stands."""
        ...

    @property
    def reason(self) -> str:
        """Return why it was lost."""
        ...

    @property
    def needs_state(self) -> bool:
        """Return whether the state is to be published at once."""
        ...

    @property
    def republish_after(self) -> int | None:
        """Return the number behind which records are published again after the session; None: none are."""
        ...

    def open(self) -> str:
        """Connect; return why that failed, or an empty text."""
        ...

    def publish_state(self, state: PlantState) -> None:
        """Publish the state and the alarms; it may be lost."""
        ...

    def publish_records(self, records: Sequence[BeltRecord]) -> int:
        """Publish records; return how many of them, from the first on, have arrived."""
        ...

    def close(self) -> None:
        """Say goodbye, and end."""
        ...


class Publisher:
    """Publishes a plant to a broker until it is closed."""

    def __init__(
        self,
        settings: MqttSettings,
        plant: Plant,
        data: Path,
        on_message: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Prepare; ``data`` is the folder of the cursor, ``on_message`` is called when a connection is lost or made.

        Raises
        ------
        InputError
            If a file of the settings cannot be read.
        """
        check_library(settings)
        self._settings, self._plant, self._on_message = settings, plant, on_message
        self._data = data
        self._password = read_password(settings.password_file)
        self._cursor = read_cursor(
            data / "mqtt.json", f"{settings.host}:{settings.broker_port}/{settings.place}", on_message
        )
        self._first_after = 0
        """Number behind which publishing begins where the cursor has none."""
        self._stop = threading.Event()
        self._thread = make_supervised_thread("mqtt", self._run, on_message, self._stop.wait)
        self.trouble = ""
        """Why there is no connection; empty while there is one."""

    def start(self) -> None:
        """Start publishing; returns at once."""
        if self._settings.first == "new" and not self._cursor.is_lost:
            self._first_after = self._plant.read_last_number()
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Return the number of records that the broker has not acknowledged."""
        return max(0, self._plant.read_last_number() - self._after)

    @property
    def _after(self) -> int:
        """Return the number of the last record that needs no publishing."""
        return self._first_after if self._cursor.number is None else self._cursor.number

    def close(self, patience_s: float = 5.0) -> None:
        """Publish what is stored, as far as the time allows, and disconnect."""
        self._stop.set()
        self._thread.join(patience_s)

    def _run(self) -> None:
        attempt = 0
        while True:
            started = monotonic()
            self._set_trouble(self._publish_until_lost())
            if self._stop.is_set():
                return
            attempt = 0 if monotonic() - started > _PAUSES_S[-1] else attempt
            if self._stop.wait(_PAUSES_S[min(attempt, len(_PAUSES_S) - 1)]):
                return
            attempt += 1

    def _make_channel(self) -> Channel:
        if self._settings.payload == "json":
            return JsonChannel(self._settings, self._password)
        from beltscape.protocols.mqtt.sparkplug import SparkplugChannel

        return SparkplugChannel(self._settings, self._password, self._data, self._on_message)

    def _publish_until_lost(self) -> str:
        """Connect and publish until the end or until the connection is lost; return why it was lost.

        A disk that refuses the cursor counts as a lost connection.
        """
        try:
            self._cursor.keep(self._after)
            channel = self._make_channel()
        except OutputError as error:
            return str(error)
        try:
            trouble = channel.open()
            if trouble:
                return trouble
            self._set_trouble("")
            self._publish_while_up(channel)
            return "" if self._stop.is_set() else channel.reason
        except OutputError as error:
            return str(error)
        finally:
            channel.close()
            if channel.republish_after is not None:
                self._cursor.keep(min(channel.republish_after, self._after))

    def _publish_while_up(self, channel: Channel) -> None:
        next_state_s = 0.0
        while channel.is_up:
            if channel.needs_state or monotonic() >= next_state_s:
                next_state_s = monotonic() + self._settings.state_every_s
                channel.publish_state(self._plant.read_state())
            if not self._publish_records(channel):
                if self._stop.is_set():
                    return
                self._stop.wait(_POLL_S)

    def _publish_records(self, channel: Channel) -> bool:
        """Publish a batch of records and advance the cursor; return whether any arrived."""
        after = self._after
        if self._plant.read_last_number() < after:
            self._on_message(
                f"mqtt: the ledger ends before record {after}, which was published; it was replaced. "
                "All its records are published"
            )
            self._cursor.keep(0)
            return True
        records = self._plant.read_records(after, _BATCH)
        arrived = channel.publish_records(records) if records else 0
        if arrived:
            self._cursor.keep(records[arrived - 1].number)
        return arrived > 0

    def _set_trouble(self, trouble: str) -> None:
        if trouble != self.trouble:
            broker = f"{self._settings.host}:{self._settings.broker_port}"
            self._on_message(f"mqtt: {broker}: {trouble or 'connected'}")
        self.trouble = trouble


def read_password(path: Path | None) -> str | None:
    """Return the first line of the password's file; None without one. InputError if it cannot be read."""
    if path is None:
        return None
    try:
        return path.read_text("utf-8").splitlines()[0]
    except (OSError, IndexError) as error:
        raise InputError(f"{path}: the broker's password cannot be read ({describe_cause(error)})") from error


def check_library(settings: MqttSettings) -> None:
    """Raise ImportError where the library of the messages' form is missing."""
    if settings.payload == "sparkplug":
        import_module("google.protobuf")


def check_settings(settings: MqttSettings) -> None:
    """Raise InputError where a file of the settings cannot be read, ImportError where a library is missing."""
    check_library(settings)
    read_password(settings.password_file)
    for path in list_tls_files(settings):
        if path is not None and not path.is_file():
            raise InputError(f"{path}: there is no such file; [mqtt] names it")


def read_cursor(path: Path, broker: str, on_message: Callable[[str], object] = lambda _: None) -> KeptNumber:
    """Return the number of the last record that the broker has acknowledged, kept on the disk; at first none."""
    key, instead = ("broker", broker), "all records of the ledger are published again, so that none is lost"
    return KeptNumber(path, "beltscape-mqtt/1", "acknowledged", key, instead, on_message)
