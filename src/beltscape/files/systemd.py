"""Notification of systemd about start and liveness: the sd_notify(3) protocol without its library."""

from __future__ import annotations

import os
import socket


def notify(state: str) -> bool:
    """Send a state such as "READY=1", "WATCHDOG=1", "STOPPING=1" or "STATUS=…"; return whether it was sent.

    Never raises and never waits: a program must not stop because its supervisor does not answer.
    """
    address = os.environ.get("NOTIFY_SOCKET", "")
    if address[:1] not in ("/", "@"):
        return False
    if address.startswith("@"):  # Linux's abstract namespace
        address = "\0" + address[1:]
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sock:
            sock.setblocking(False)
            sock.sendto(state.encode(), address)
    except OSError:
        return False
    return True


def watchdog_s() -> float | None:
    """Return after what time without "WATCHDOG=1" systemd restarts the program (send twice as often); None: never."""
    try:
        wait_us, process = int(os.environ["WATCHDOG_USEC"]), int(os.environ.get("WATCHDOG_PID", os.getpid()))
    except (KeyError, ValueError):
        return None
    return wait_us * 1e-6 if wait_us > 0 and process == os.getpid() else None
