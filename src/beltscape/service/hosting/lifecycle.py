"""The lifecycle of a run in a terminal or under systemd: log, stop signals, watchdog, summary."""

from __future__ import annotations

import logging
import signal
import sys
import threading
from collections.abc import Callable, Mapping
from time import monotonic
from typing import Any

from beltscape.core.runtime.supervision import log_uncaught_errors
from beltscape.files.systemd import notify, watchdog_s
from beltscape.service.hosting.server import RunningServer


def log_to_stderr() -> None:
    """Write the log to standard error, with date and level."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    log = logging.getLogger("beltscape")
    log.handlers[:] = [handler]
    log.setLevel(logging.INFO)
    log.propagate = False
    # a line for every answer to a client that has left, which would let anybody fill the log
    logging.getLogger("asyncio").setLevel(logging.ERROR)
    log_uncaught_errors()


def make_stop_event() -> threading.Event:
    """Return an event that SIGINT and SIGTERM set."""
    event = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda _number, _frame: event.set())
    return event


def log_address(page: RunningServer | None) -> None:
    """Log the page's address, if there is a page, and its warnings."""
    log = logging.getLogger("beltscape")
    for warning in () if page is None else page.warnings:
        log.warning("%s", warning)
    log.info("measuring%s", "" if page is None else f"; the page is at {page.address}")


def make_watchdog() -> Callable[[], None]:
    """Return a function that notifies systemd's watchdog, three times in its interval."""
    interval_s = watchdog_s()
    if interval_s is None:
        return lambda: None
    last_s = [float("-inf")]

    def notify_watchdog() -> None:
        if monotonic() - last_s[0] > interval_s / 3:
            last_s[0] = monotonic()
            notify("WATCHDOG=1")

    return notify_watchdog


def format_summary(result: Mapping[str, Any]) -> str:
    """Return the summary of a run in a few lines."""
    valid, degraded, missing = (result[f"{name}_mm"] * 1e-3 for name in ("valid", "degraded", "missing"))
    lines = [
        f"volume {result['volume_mm3'] * 1e-6:.3f} l on {valid + degraded + missing:.3f} m of belt in "
        f"{result['records']} records",
        f"belt   {valid:.3f} m valid, {degraded:.3f} m degraded, {missing:.3f} m missing",
    ]
    if result["mass_kg"] == result["mass_kg"]:
        lines.append(f"mass   {result['mass_kg']:.2f} kg")
    if result["unwritten_records"]:
        lines.append(
            f"{result['unwritten_records']} records could not be written to disk; see the log for the reason"
        )
    return "\n".join([*lines, f"history in {result['data']}"])
