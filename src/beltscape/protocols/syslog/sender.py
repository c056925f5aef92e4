"""The sender: a thread that sends every change of an alarm to the syslog server, without delaying anybody."""

from __future__ import annotations

import os
import socket
import threading
from collections import deque
from collections.abc import Callable, Sequence
from time import monotonic, time_ns

from beltscape.core.errors import InputError, describe_cause
from beltscape.core.live.alarms import PRIORITIES, Alarm
from beltscape.core.runtime.supervision import make_supervised_thread
from beltscape.protocols.client_tls import make_client_context
from beltscape.protocols.syslog.rfc5424 import (
    Origin,
    SyslogMessage,
    describe_change,
    describe_losses,
    format_message,
)
from beltscape.protocols.syslog.settings import SyslogSettings
from beltscape.protocols.syslog.transport import SyslogConnection

_PAUSES_S = (0.5, 1.0, 2.0, 5.0, 10.0, 30.0)
"""Pauses between attempts to connect; the last one repeats."""
_State = tuple[str, str, str]


class SyslogSender:
    """Sends the changes of alarms until it is closed; ``on_alarms`` returns at once."""

    def __init__(self, settings: SyslogSettings, on_message: Callable[[str], None] = lambda _: None) -> None:
        """Prepare; ``on_message`` gets a line when the connection is lost or made, and when messages were dropped."""
        self._settings, self._on_message = settings, on_message
        self._origin = Origin(
            settings.facility,
            settings.hostname or socket.gethostname(),
            settings.app_name,
            str(os.getpid()),
            settings.enterprise,
        )
        self._states: dict[str, _State] = {}
        self._waiting: deque[SyslogMessage] = deque()
        self._changed = threading.Condition()
        self._is_closing = False
        self._stop = threading.Event()
        self._number = 0
        self._unreported = 0
        self.lost = 0
        """Messages dropped since the start because the queue was full."""
        self.trouble = ""
        """Why there is no connection; empty while there is one, or nothing to send."""
        self._thread = make_supervised_thread("syslog", self._run, on_message, self._stop.wait)

    def start(self) -> None:
        """Start sending; returns at once."""
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Return the number of messages that are not sent yet."""
        return len(self._waiting)

    def on_alarms(self, alarms: Sequence[Alarm]) -> None:
        """Add a message for every alarm that has changed; the oldest one is dropped where the queue is full."""
        wall_ns = time_ns()
        with self._changed:
            for alarm in alarms:
                state = _read_state(alarm)
                before = self._states.get(alarm.name, ("clear", "clear", ""))
                self._states[alarm.name] = state
                if state != before and self._is_wanted(alarm):
                    self._add(describe_change(alarm, wall_ns))
            self._changed.notify()

    def close(self, patience_s: float = 3.0) -> None:
        """Send what waits, as far as the time allows, and disconnect."""
        deadline_s = monotonic() + patience_s
        with self._changed:
            self._is_closing = True
            self._changed.notify()
        self._thread.join(patience_s * 0.8)
        self._stop.set()
        self._thread.join(max(0.1, deadline_s - monotonic()))

    def _is_wanted(self, alarm: Alarm) -> bool:
        return PRIORITIES.index(alarm.priority) >= PRIORITIES.index(self._settings.least)

    def _add(self, message: SyslogMessage) -> None:
        if len(self._waiting) >= self._settings.queue:
            self._waiting.popleft()
            self._number += 1  # its number is missing at the server
            self.lost += 1
            self._unreported += 1
        self._waiting.append(message)

    def _run(self) -> None:
        attempt = 0
        while self._await_message():
            before = self._number
            trouble = self._send_until_lost()
            if not trouble:
                return
            self._set_trouble(trouble)
            attempt = 0 if self._number > before else attempt + 1
            if self._is_closing or self._stop.wait(_PAUSES_S[min(attempt, len(_PAUSES_S) - 1)]):
                return

    def _send_until_lost(self) -> str:
        """Connect and send until the end or until the connection is lost; return why it was lost."""
        try:
            connection = SyslogConnection(self._settings)
        except OSError as error:
            return f"not connected ({describe_cause(error)})"
        try:
            self._set_trouble("")
            self._report_losses(connection)
            while self._await_message():
                message = self._waiting[0]
                connection.send(format_message(message, self._origin, self._number, connection.limit))
                with self._changed:
                    # where the queue overflowed meanwhile, the message is no longer in it
                    if self._waiting and self._waiting[0] is message:
                        self._waiting.popleft()
                        self._number += 1
            return ""
        except OSError as error:
            return f"connection lost ({describe_cause(error)})"
        finally:
            connection.close()

    def _report_losses(self, connection: SyslogConnection) -> None:
        """Tell the server and the page how many messages were dropped."""
        with self._changed:
            count = self._unreported
        if not count:
            return
        lost = describe_losses(count, time_ns())
        connection.send(format_message(lost, self._origin, self._number, connection.limit))
        self._on_message(f"syslog: {self._name_server()}: {lost.text}")
        with self._changed:
            self._unreported -= count
            self._number += 1

    def _await_message(self) -> bool:
        """Wait for a message; return False where none will come."""
        with self._changed:
            while not self._waiting and not self._is_closing:
                self._changed.wait()
            return bool(self._waiting) and not self._stop.is_set()

    def _set_trouble(self, trouble: str) -> None:
        if trouble != self.trouble:
            self._on_message(f"syslog: {self._name_server()}: {trouble or 'connected'}")
        self.trouble = trouble

    def _name_server(self) -> str:
        return f"{self._settings.host}:{self._settings.server_port}"


def check_settings(settings: SyslogSettings) -> str:
    """Return a line about where alarms would go; InputError where a file of the settings cannot be used."""
    if settings.transport == "tls":
        try:
            make_client_context(settings.tls_ca, settings.tls_certificate, settings.tls_key)
        except OSError as error:
            files = ", ".join(
                str(file) for file in (settings.tls_ca, settings.tls_certificate, settings.tls_key) if file
            )
            raise InputError(f"[syslog] {files}: cannot be used for TLS ({error})") from error
    return (
        f"{settings.host} port {settings.server_port}, {settings.transport}, from priority {settings.least}"
    )


def _read_state(alarm: Alarm) -> _State:
    """Return what a message is about; to suppress a clear alarm because of a state of the plant changes nothing."""
    hidden = alarm.suppression
    by_person = "" if hidden is None or hidden.kind == "by_state" else f"{hidden.kind} {hidden.until_ns}"
    return alarm.state, alarm.hidden_state, by_person
