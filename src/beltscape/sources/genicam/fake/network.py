"""Addresses for simulated cameras on the loopback interface, best in a network namespace of its own."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
from collections.abc import Generator, Iterable
from contextlib import contextmanager

from beltscape.core.errors import OutputError

CLONE_NEWNET = 0x40000000
"""Flag of unshare(2): a network namespace of its own (linux/sched.h)."""


def add_addresses(addresses: Iterable[str]) -> None:
    """Add addresses to the loopback interface, unless it has them; OutputError if the rights are missing."""
    _ip("link", "set", "lo", "up")
    present = subprocess.run(
        ["ip", "-o", "addr", "show", "dev", "lo"], capture_output=True, text=True, check=False
    )
    for address in addresses:
        if f"{address}/8" not in present.stdout:
            # a label of its own: Aravis identifies interfaces by their names
            _ip("addr", "add", f"{address}/8", "dev", "lo", "label", f"lo:{address.rpartition('.')[2]}")


def _ip(*arguments: str) -> None:
    if shutil.which("ip") is None:
        raise OutputError("simulated cameras: the program ip is missing; install Debian's iproute2")
    done = subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise OutputError(f"ip {' '.join(arguments)}: {done.stderr.strip()}; it needs the rights of root")


@contextmanager
def own_network(addresses: Iterable[str]) -> Generator[None]:
    """Give this thread, the threads it starts and their programs a network of their own with ``addresses``.

    OutputError if the rights are missing.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    here = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
    try:
        if libc.unshare(CLONE_NEWNET):
            raise OutputError(
                f"no network of its own ({os.strerror(ctypes.get_errno())}); it needs the rights of root"
            )
        try:
            add_addresses(addresses)
            yield
        finally:
            libc.setns(here, CLONE_NEWNET)
    finally:
        os.close(here)
