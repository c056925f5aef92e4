"""Notification of systemd over its socket."""

from __future__ import annotations

import os
import socket

import pytest

from beltscape.core.system_calls import notify, watchdog_s


@pytest.fixture
def supervisor(tmp_path, monkeypatch):
    """A function address → socket that listens there, named in the environment."""
    opened = []

    def listen(address):
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        opened.append(sock)
        sock.settimeout(2)
        sock.bind(address.replace("@", "\0", 1) if address.startswith("@") else address)
        monkeypatch.setenv("NOTIFY_SOCKET", address)
        return sock

    yield listen
    for sock in opened:
        sock.close()


@pytest.mark.parametrize("where", ["file", "abstract"])
def test_notification_is_received(supervisor, tmp_path, where):
    sock = supervisor(str(tmp_path / "notify") if where == "file" else f"@beltscape-test-{os.getpid()}")
    assert notify("READY=1")
    assert notify("STATUS=5 cameras, 1200 m³/h")
    assert sock.recv(100) == b"READY=1"
    assert sock.recv(100).decode() == "STATUS=5 cameras, 1200 m³/h"


@pytest.mark.parametrize(
    "address", [None, "", "relative", "/nowhere/at/all", "@nobody-listens", "/" + "x" * 300]
)
def test_missing_supervisor_is_no_failure(monkeypatch, address):
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    if address is not None:
        monkeypatch.setenv("NOTIFY_SOCKET", address)
    assert not notify("READY=1")


def test_supervisor_that_does_not_read_does_not_block(supervisor, tmp_path):
    supervisor(str(tmp_path / "notify"))
    assert not all(notify("WATCHDOG=1") for _ in range(5000))


def test_the_watchdog_is_for_this_process(monkeypatch):
    monkeypatch.delenv("WATCHDOG_PID", raising=False)
    for value, wait in (("30000000", 30.0), ("0", None), ("soon", None)):
        monkeypatch.setenv("WATCHDOG_USEC", value)
        assert watchdog_s() == wait
    monkeypatch.setenv("WATCHDOG_USEC", "30000000")
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()))
    assert watchdog_s() == 30.0
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid() + 1))
    assert watchdog_s() is None
    monkeypatch.delenv("WATCHDOG_USEC")
    assert watchdog_s() is None
