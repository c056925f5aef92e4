"""Warnings of a running system: repeated ones are suppressed for a time, and repairs of the history are named."""

from __future__ import annotations

import re
import threading
from collections import OrderedDict
from time import monotonic

from beltscape.core.interfaces import Observer
from beltscape.core.progress import Reporter
from beltscape.sinks.historian import Historian

_REPEAT_S = 300.0
"""A message is repeated after this time at the earliest."""
_LARGEST_HISTORY = 500
"""Number of messages that are remembered, which bounds the memory."""


class DeduplicatingReporter:
    """A ``Reporter`` that passes warnings to an observer; messages that differ only in numbers count as the same."""

    def __init__(self, observer: Observer, repeat_s: float = _REPEAT_S) -> None:
        """``repeat_s``: time during which the same message is not repeated."""
        self._observer, self._repeat_s = observer, repeat_s
        self._last_s: OrderedDict[str, float] = OrderedDict()
        self._lock = threading.Lock()

    def step(self, stage: str, done: int, total: int) -> None:
        """Ignore progress: a running system has no end."""

    def warn(self, message: str) -> None:
        """Pass the message on, unless the same message was passed on recently."""
        kind, now = re.sub(r"\d+", "#", message), monotonic()
        with self._lock:
            if now - self._last_s.get(kind, float("-inf")) < self._repeat_s:
                return
            self._last_s[kind] = now
            self._last_s.move_to_end(kind)
            while len(self._last_s) > _LARGEST_HISTORY:
                self._last_s.popitem(last=False)
        self._observer.on_message(message)


HOLD_S = 10.0
"""Time for which a repair counts as present; its alarm then stays until it is acknowledged."""


class RepairNotice:
    """Watches the history for changes by other programs, which the history repairs."""

    def __init__(self, historian: Historian, reporter: Reporter) -> None:
        self._historian, self._reporter = historian, reporter
        self._message = ""
        self._since_s = float("-inf")

    def check(self) -> None:
        """Verify the history; it may wait for the disk."""
        self._historian.verify()
        message = self._historian.repair_message
        if message != self._message:
            self._message, self._since_s = message, monotonic()
            self._reporter.warn(message)

    @property
    def text(self) -> str:
        """Return the text of a repair of the last seconds; empty without one."""
        return self._message if monotonic() - self._since_s < HOLD_S else ""
