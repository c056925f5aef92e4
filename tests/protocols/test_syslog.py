"""Alarms to a syslog server: the form of messages, all transports, servers that go away, a queue that is full."""

from __future__ import annotations

import socket
import ssl
import threading
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.alarms import Alarm, Suppression
from beltscape.core.errors import InputError
from beltscape.protocols.settings import SyslogSettings
from beltscape.protocols.syslog import (
    UDP_BYTES,
    Origin,
    SyslogMessage,
    SyslogSender,
    check_settings,
    describe_change,
    format_message,
    frame_octets,
)
from tests.protocols.broker import wait_until
from tests.protocols.syslog_server import Server, parse, split_frames
from tests.service.access.certificates import make_certificate

NAN = float("nan")
ORIGIN = Origin(16, "measuring-pc", "belt4", "77", 32473)
OVERLOAD = Alarm(
    "overload", "critical", "raised", 112.5, 100.0, "m³/h", 1, "112 m³/h, limit 100 m³/h: slow the feed",
    priority="urgent", group="load", is_first=True,
)  # fmt: skip


def settings(server: Server, **more: object) -> SyslogSettings:
    return SyslogSettings.model_validate(
        {"host": "127.0.0.1", "port": server.port, "transport": server.kind, **more}
    )


def change(k: int) -> list[Alarm]:
    """Return an alarm that differs from the one before it."""
    return [replace(OVERLOAD, state="raised" if k % 2 == 0 else "gone")]


def test_a_message_has_priority_text_and_fields() -> None:
    got = parse(format_message(describe_change(OVERLOAD, 1_790_000_000_123_456_789), ORIGIN, 41))
    assert (got.facility, got.severity, got.msgid) == (16, 1, "overload")
    assert (got.host, got.app) == ("measuring-pc", "belt4")
    assert b" 2026-09-21T14:13:20.123456Z " in got.raw
    assert got.text == "overload raised: 112 m³/h, limit 100 m³/h: slow the feed"
    assert (got.number, got.data["origin"]["software"]) == (42, "beltscape")
    assert got.alarm == {
        "name": "overload", "state": "raised", "isaState": "unacknowledged", "priority": "urgent",
        "severity": "critical", "value": "112.5", "limit": "100", "unit": "m³/h", "group": "load", "first": "true",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("alarm", "severity", "text"),
    [
        (replace(OVERLOAD, priority="high", detail=""), 2, "overload raised"),
        (replace(OVERLOAD, state="acknowledged", by="ada", detail=""), 6, "overload acknowledged by ada"),
        (replace(OVERLOAD, state="clear", detail=""), 6, "overload clear"),
        (
            replace(
                OVERLOAD,
                state="clear",
                hidden_state="raised",
                detail="",
                suppression=Suppression("shelved", "scale test", "ada", 1, 2),
            ),
            6,
            "overload raised (shelved: scale test)",
        ),
    ],
)
def test_what_follows_a_raised_alarm_is_informational(alarm: Alarm, severity: int, text: str) -> None:
    got = parse(format_message(describe_change(alarm, 0), ORIGIN, 0))
    assert (got.severity, got.text) == (severity, text)


TEXTS = st.text(st.characters(codec="utf-8"), max_size=60)


@given(TEXTS, TEXTS, TEXTS, st.integers(0, 2**33), st.sampled_from([None, 200, UDP_BYTES]))
def test_any_text_gives_one_message_that_can_be_taken_apart(text, value, name, number, limit) -> None:
    origin = replace(ORIGIN, hostname=name)
    raw = format_message(SyslogMessage(0, 4, name, {"name": value}, text), origin, number, limit)
    got = parse(raw)
    assert 1 <= got.number <= 2**31 - 1
    if limit is None:
        assert got.alarm["name"].replace(" ", "") == "".join(
            c for c in value if not (ord(c) < 33 or 127 <= ord(c) < 160)
        ).replace(" ", "")
    stream = bytearray(frame_octets(raw) * 2)
    assert list(split_frames(stream)) == [raw, raw] and not stream


def test_a_datagram_is_cut_between_letters() -> None:
    raw = format_message(SyslogMessage(0, 4, "overload", {}, "ü" * 2000), ORIGIN, 0, UDP_BYTES)
    assert UDP_BYTES - 2 <= len(raw) <= UDP_BYTES
    assert set(parse(raw).text) == {"ü"}


def make_server(kind: str, folder: Path) -> tuple[Server, dict[str, object]]:
    """Return a server and the settings that its transport needs."""
    if kind != "tls":
        return Server(kind), {}
    certificate, key = make_certificate(folder, "syslog")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    return Server(kind, context=context), {"tls_ca": certificate, "host": "localhost"}


@pytest.mark.parametrize("kind", ["udp", "tcp", "tls"])
def test_every_change_arrives_once_in_order(kind: str, tmp_path: Path) -> None:
    server, more = make_server(kind, tmp_path)
    with closing(server):
        sender = SyslogSender(settings(server, **more))
        sender.start()
        for k in range(50):
            sender.on_alarms(change(k))
            sender.on_alarms(change(k))  # no change, no message
        sender.close()
        wait_until(lambda: len(server.received) == 50)
    assert server.failures == []
    assert [one.number for one in server.received] == list(range(1, 51))
    assert [one.alarm["state"] for one in server.received] == ["raised", "gone"] * 25


def test_tls_checks_the_certificate_of_the_server(tmp_path: Path) -> None:
    server, more = make_server("tls", tmp_path)
    other, _ = make_certificate(tmp_path, "other")
    lines: list[str] = []
    with closing(server):
        sender = SyslogSender(settings(server, **{**more, "tls_ca": other}), lines.append)
        sender.start()
        sender.on_alarms(change(0))
        wait_until(lambda: bool(sender.trouble))
        assert "certificate verify failed" in sender.trouble and server.received == []
        sender.close(0.2)
    assert "certificate verify failed" in lines[0]


def test_what_waits_is_sent_after_the_server_was_away() -> None:
    first = Server("tcp")
    lines: list[str] = []
    sender = SyslogSender(settings(first), lines.append)
    sender.start()
    for k in range(10):
        sender.on_alarms(change(k))
    wait_until(lambda: len(first.received) == 10)
    first.close()
    for k in range(10, 40):
        sender.on_alarms(change(k))
    wait_until(lambda: bool(sender.trouble))
    second = Server("tcp", first.port)
    with closing(second):
        wait_until(lambda: len(second.received) == 30)
        sender.close()
    assert [one.number for one in second.received] == list(range(11, 41))
    assert sender.lost == 0 and "connected" in lines[-1]


def test_a_full_queue_drops_the_oldest_and_says_so_to_both_sides() -> None:
    away = Server("tcp")
    away.close()
    lines: list[str] = []
    sender = SyslogSender(settings(away, queue=5), lines.append)
    sender.start()
    began_s = time.perf_counter()
    for k in range(100):
        sender.on_alarms(change(k))
    assert time.perf_counter() - began_s < 1.0  # nobody waits for a server
    assert sender.waiting == 5 and sender.lost == 95
    server = Server("tcp", away.port)
    with closing(server):
        wait_until(lambda: len(server.received) == 6)
        sender.close()
    losses, *rest = server.received
    assert (losses.msgid, losses.alarm) == ("losses", {"lost": "95"})
    assert [one.number for one in rest] == list(range(97, 102))  # the gap is as long as the losses
    assert any("95 messages were dropped" in line for line in lines)


def test_a_server_that_takes_nothing_delays_nobody() -> None:
    server, end = Server("tcp"), threading.Event()

    def take_nothing(connection: socket.socket) -> None:
        with closing(connection):
            end.wait(30)

    with closing(server):
        server._read = take_nothing  # type: ignore[method-assign]
        sender = SyslogSender(settings(server, queue=100))
        sender.start()
        big = replace(OVERLOAD, detail="x" * 10_000)
        began_s = time.process_time()
        for k in range(3000):
            sender.on_alarms([replace(big, state="raised" if k % 2 else "gone")])
        assert time.process_time() - began_s < 2.0
        assert sender.lost > 0
        sender.close(0.2)
        end.set()


def test_suppression_by_state_is_sent_only_for_an_alarm_that_is_on() -> None:
    server = Server("udp")
    stopped = Suppression("by_state", "belt_stopped")
    clear = replace(OVERLOAD, name="empty", state="clear")
    with closing(server):
        sender = SyslogSender(settings(server))
        sender.start()
        sender.on_alarms([clear, OVERLOAD])
        sender.on_alarms([
            replace(clear, suppression=stopped),
            replace(OVERLOAD, state="clear", hidden_state="raised", suppression=stopped),
        ])  # fmt: skip
        sender.on_alarms([clear, OVERLOAD])
        sender.close()
        wait_until(lambda: len(server.received) == 3)
    assert [one.text.partition(":")[0] for one in server.received] == [
        "overload raised", "overload raised (suppressed by design", "overload raised",
    ]  # fmt: skip


def test_alarms_below_the_least_priority_stay_away() -> None:
    server = Server("udp")
    with closing(server):
        sender = SyslogSender(settings(server, least="high"))
        sender.start()
        sender.on_alarms([replace(OVERLOAD, name="empty", priority="medium"), OVERLOAD])
        sender.close()
        wait_until(lambda: bool(server.received))
    assert [one.alarm["name"] for one in server.received] == ["overload"]


def test_datagrams_arrive_again_as_soon_as_the_server_is_back() -> None:
    away = Server("udp")
    away.close()
    sender = SyslogSender(settings(away))
    sender.start()
    sender.on_alarms(change(0))  # lost without notice: that is how UDP is
    wait_until(lambda: sender.waiting == 0)
    server = Server("udp", away.port)
    with closing(server):
        sender.on_alarms(change(1))
        wait_until(lambda: bool(server.received))
        sender.close()
    assert server.received[0].number == 2


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"host": "a", "transport": "sctp"}, "'udp', 'tcp' or 'tls'"),
        ({"host": "a", "tls_ca": "ca.pem"}, "does not use tls_ca"),
        ({"host": "a", "transport": "tls", "tls_key": "key.pem"}, "tls_certificate is missing"),
        ({"host": "a", "app_name": "belt 4"}, "app_name"),
        ({"host": "a", "facility": 24}, "facility"),
    ],
)
def test_settings_that_cannot_be_are_refused(given: dict[str, object], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        SyslogSettings.model_validate(given)


def test_a_missing_certificate_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"missing\.pem: cannot be used for TLS"):
        check_settings(SyslogSettings(host="a", transport="tls", tls_ca=tmp_path / "missing.pem"))
    assert check_settings(SyslogSettings(host="a")) == "a port 514, udp, from priority low"
