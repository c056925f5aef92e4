"""A server of a protocol: a supervised thread with an event loop of its own that listens on a port.

Also the addresses by which this machine may be reached.
"""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Callable, Coroutine
from contextlib import suppress
from ipaddress import ip_address

from beltscape.core.errors import InputError
from beltscape.core.supervision import make_supervised_thread
from beltscape.core.system_calls import list_interface_addresses

EVERYWHERE = ("0.0.0.0", "::")
"""Addresses to listen on that are no address to connect to."""


class ListeningThread:
    """Runs a coroutine that listens; it starts again after a failure, also where the port is taken meanwhile."""

    def __init__(
        self,
        table: str,
        serve: Callable[[], Coroutine[None, None, None]],
        on_message: Callable[[str], None],
        patience_s: float,
    ) -> None:
        """``serve`` calls `confirm` or `fail`, and returns when `is_stopped`; ``table``: of the settings."""
        self._table, self._on_message, self._patience_s = table, on_message, patience_s
        self._stop, self._answered = threading.Event(), threading.Event()
        self._failure = ""
        self._thread = make_supervised_thread(
            table, lambda: asyncio.run(serve()), self._on_failure, self._stop.wait
        )

    @property
    def is_stopped(self) -> bool:
        """Return whether the server shall end."""
        return self._stop.is_set()

    def start(self, host: str, port: int, fix: str) -> None:
        """Start, and wait until the server listens.

        Raises
        ------
        InputError
            If the address is in use or not allowed; ``fix`` says what to do then.
        """
        self._thread.start()
        if not self._answered.wait(self._patience_s) or self._failure:
            self._stop.set()
            raise InputError(
                f"[{self._table}]: {host} port {port} cannot be listened on ({self._failure or 'no answer'}); {fix}"
            )

    def confirm(self) -> None:
        """Tell that the server listens."""
        self._answered.set()

    def fail(self, error: Exception) -> None:
        """Tell that the address cannot be listened on; at a restart the error is raised, and it is tried again."""
        if self._answered.is_set():
            raise error
        self._failure = str(error)
        self._answered.set()

    def close(self, patience_s: float) -> None:
        """Stop the server and wait for its end."""
        self._stop.set()
        self._thread.join(patience_s)

    def _on_failure(self, failure: str) -> None:
        self._on_message(f"{self._table}: {failure}; it starts again")


def find_routed_addresses() -> set[str]:
    """Return the addresses by which this machine reaches others; nothing is sent. Empty without a network."""
    found = set[str]()
    for family, other in (
        (socket.AF_INET, "192.0.2.1"),
        (socket.AF_INET6, "2001:db8::1"),
    ):  # for documentation
        with suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.connect((other, 9))
            found.add(probe.getsockname()[0])
    return found


def list_own_addresses() -> set[str]:
    """Return the addresses of this machine: routed ones, loopback, and the IPv4 ones of all its interfaces."""
    return find_routed_addresses() | {"127.0.0.1", "::1"} | list_interface_addresses()


def is_address(host: str) -> bool:
    """Return whether a host is an IP address, not a name."""
    with suppress(ValueError):
        ip_address(host)
        return True
    return False


def normalise_host(host: str) -> str:
    """Return a name in lower case, an address in its shortest form."""
    return str(ip_address(host)) if is_address(host) else host.lower()
