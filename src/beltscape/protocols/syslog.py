"""Alarms to a syslog server: RFC 5424 messages over UDP (RFC 5426), TCP (RFC 6587) or TLS (RFC 5425).

A thread sends every change of an alarm, without delaying anybody. This is own code, because the libraries for Python
send from the caller's thread, wait for the server, and do not say what they lost. The standard library's handler
knows RFC 3164 only.
"""

from __future__ import annotations

import math
import os
import select
import socket
import ssl
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from time import monotonic, time_ns
from typing import Literal

from beltscape import __version__
from beltscape.core.alarms import PRIORITIES, Alarm, Priority
from beltscape.core.errors import InputError, describe_cause
from beltscape.core.supervision import make_supervised_thread
from beltscape.protocols.client_tls import make_client_context
from beltscape.protocols.settings import SyslogSettings

Severity = Literal[1, 2, 4, 5, 6]
"""alert, critical, warning, notice, informational (RFC 5424, table 2)"""
_SEVERITIES: Mapping[Priority, Severity] = {"urgent": 1, "high": 2, "medium": 4, "low": 5}
"""Severity of a raised alarm; what follows it is informational."""
_INFORMATIONAL: Severity = 6
UDP_BYTES = 1180
"""Longest datagram: with the headers of IPv6 and UDP it fits the least MTU of 1280 bytes (RFC 5426, 3.2)."""
_MSGID_LENGTH = 32
"""Longest message identifier (RFC 5424, 6)."""
_SEQUENCE = 2**31 - 1
"""Greatest sequenceId; it then starts at 1 again (RFC 5424, 7.3.1)."""
_BOM = b"\xef\xbb\xbf"
"""Marks a text in UTF-8 (RFC 5424, 6.4)."""


@dataclass(frozen=True, slots=True)
class Origin:
    """The sender: the parts that all its messages share."""

    facility: int
    hostname: str
    app_name: str
    process: str
    enterprise: int


@dataclass(frozen=True, slots=True)
class SyslogMessage:
    """One message before it has a number."""

    wall_ns: int
    """System clock."""
    severity: Severity
    kind: str
    """SyslogMessage identifier: the kind of the alarm."""
    fields: Mapping[str, str]
    """Structured data."""
    text: str


def describe_change(alarm: Alarm, wall_ns: int) -> SyslogMessage:
    """Return the message about an alarm's present state."""
    hidden = alarm.suppression
    is_raised = alarm.state == "raised"
    state = alarm.state if hidden is None else alarm.hidden_state
    parts = [alarm.name, state]
    if hidden is not None:
        parts.append(f"({alarm.isa_state.replace('_', ' ')}: {hidden.reason})")
    if alarm.by and state in ("acknowledged", "latched"):
        parts.append(f"by {alarm.by}")
    text = " ".join(parts) + (f": {alarm.detail}" if alarm.detail else "")
    severity = _SEVERITIES[alarm.priority] if is_raised else _INFORMATIONAL
    return SyslogMessage(wall_ns, severity, alarm.name.partition(":")[0], _list_fields(alarm, state), text)


def _list_fields(alarm: Alarm, state: str) -> dict[str, str]:
    hidden = alarm.suppression
    fields = {
        "name": alarm.name,
        "state": state,
        "isaState": alarm.isa_state,
        "priority": alarm.priority,
        "severity": alarm.severity,
        "value": _format_number(alarm.value),
        "limit": _format_number(alarm.limit),
        "unit": alarm.unit,
        "group": alarm.group,
        "first": "true" if alarm.is_first else "",
        "by": alarm.by if hidden is None else hidden.by,
        "reason": "" if hidden is None else hidden.reason,
    }
    return {name: value for name, value in fields.items() if value}


def describe_losses(count: int, wall_ns: int) -> SyslogMessage:
    """Return the message that says how many messages were dropped before it."""
    text = f"{count} messages were dropped while the server was away"
    return SyslogMessage(wall_ns, 4, "losses", {"lost": str(count)}, text)


def format_message(message: SyslogMessage, origin: Origin, number: int, limit: int | None = None) -> bytes:
    """Return a message by RFC 5424; its text is cut so that it has at most ``limit`` bytes.

    ``number`` counts the messages from 0, so that the server sees gaps (sequenceId).
    """
    priority = origin.facility * 8 + message.severity
    parts = (
        (origin.hostname, 255),
        (origin.app_name, 48),
        (origin.process, 128),
        (message.kind, _MSGID_LENGTH),
    )
    header = [f"<{priority}>1", _format_time(message.wall_ns), *(_to_ascii(*part) for part in parts)]
    data = _format_element("meta", {"sequenceId": str(number % _SEQUENCE + 1)})
    data += _format_element("origin", {"software": "beltscape", "swVersion": __version__})
    data += _format_element(f"alarm@{origin.enterprise}", message.fields)
    line = f"{' '.join(header)} {data} ".encode()
    text = _to_line(message.text)
    body = text.encode() if text.isascii() else _BOM + text.encode()
    if limit is not None and len(line) + len(body) > limit:
        body = body[: max(0, limit - len(line))].decode("utf-8", "ignore").encode()
    return line + body


def frame_octets(message: bytes) -> bytes:
    """Return a message for a stream, its length before it (RFC 5425, 4.3; RFC 6587, 3.4.1)."""
    return str(len(message)).encode() + b" " + message


def _format_element(name: str, fields: Mapping[str, str]) -> str:
    values = "".join(f' {key}="{_escape(value)}"' for key, value in fields.items())
    return f"[{name}{values}]"


def _escape(value: str) -> str:
    """Return a value of structured data; quote, backslash and closing bracket are escaped (RFC 5424, 6.3.3)."""
    escaped = _to_line(value).replace("\\", "\\\\").replace('"', '\\"').replace("]", "\\]")
    return escaped.encode("utf-8", "replace").decode()


def _to_line(text: str) -> str:
    """Return a text without control characters, which could fake a second message."""
    return "".join(" " if ord(letter) < 32 or 127 <= ord(letter) < 160 else letter for letter in text)


def _to_ascii(text: str, length: int) -> str:
    """Return a part of the header: printable ASCII; "-" where there is nothing."""
    kept = "".join(letter if "!" <= letter <= "~" else "_" for letter in text)
    return kept[:length] or "-"


def _format_time(wall_ns: int) -> str:
    seconds, ns = divmod(wall_ns, 1_000_000_000)
    time = datetime.fromtimestamp(seconds, UTC).replace(microsecond=ns // 1000)
    return time.isoformat(timespec="microseconds").replace("+00:00", "Z")


def _format_number(value: float) -> str:
    return f"{value:.6g}" if math.isfinite(value) else ""


_TIMEOUT_S = 5.0
"""Time to connect, and to send one message. Chosen: a server that takes longer is as good as away."""


class SyslogConnection:
    """A connection; OSError where it cannot be made or is lost."""

    def __init__(self, settings: SyslogSettings) -> None:
        """Connect; OSError with the reason otherwise."""
        self.limit = UDP_BYTES if settings.transport == "udp" else None
        """Longest message in bytes; None: any."""
        address = settings.host, settings.server_port
        if settings.transport == "udp":
            family, kind, protocol, _, place = socket.getaddrinfo(*address, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, kind, protocol)
            self._socket.connect(place)
            return
        plain = socket.create_connection(address, _TIMEOUT_S)
        try:
            plain.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            self._socket = plain if settings.transport == "tcp" else _encrypt(plain, settings)
        except BaseException:
            plain.close()
            raise

    def send(self, message: bytes) -> None:
        """Send a message; OSError if the connection is lost."""
        if self.limit is not None:
            try:
                self._socket.send(message)
            except ConnectionRefusedError:  # the answer to an earlier datagram; this one was not sent
                with suppress(ConnectionRefusedError):
                    self._socket.send(message)
            return
        self._require_open()
        self._socket.sendall(frame_octets(message))

    def close(self) -> None:
        """End the connection."""
        with suppress(OSError):
            if self.limit is None:
                self._socket.shutdown(socket.SHUT_WR)
        self._socket.close()

    def _require_open(self) -> None:
        """Raise OSError where the server has closed the stream: what is sent after that is lost without notice."""
        while select.select([self._socket], [], [], 0)[0]:
            self._socket.settimeout(0.0)
            try:
                if not self._socket.recv(4096):
                    raise ConnectionResetError("the server has closed the connection")
            except (BlockingIOError, ssl.SSLWantReadError):
                return
            finally:
                self._socket.settimeout(_TIMEOUT_S)


def _encrypt(plain: socket.socket, settings: SyslogSettings) -> ssl.SSLSocket:
    context = make_client_context(settings.tls_ca, settings.tls_certificate, settings.tls_key)
    return context.wrap_socket(plain, server_hostname=settings.host)


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
