"""Syslog messages by RFC 5424: header, structured data and text of a change of an alarm."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal

from beltscape import __version__
from beltscape.core.live.alarms import Alarm, Priority

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
