"""Triggers of single shots: a key, or a fixed interval."""

from __future__ import annotations

import sys
import threading
import time
from typing import Protocol, TextIO

from beltscape.core.runtime.supervision import make_supervised_thread
from beltscape.core.runtime.system_calls import read_key


class Trigger(Protocol):
    """Says when the next shot is due, and when there are no more."""

    def is_due(self) -> bool:
        """Return whether a shot is due now; one that was returned is used up."""
        ...

    @property
    def is_finished(self) -> bool:
        """True if no further shot will be due."""
        ...


class TimedTrigger:
    """A shot at once, then one after each interval, up to a number of them."""

    def __init__(self, interval_s: float, shots: int) -> None:
        """``interval_s`` 0: every frame set."""
        self._interval_s, self._left = interval_s, shots
        self._next_s = time.monotonic()

    def is_due(self) -> bool:
        """See `Trigger`."""
        if self._left <= 0 or time.monotonic() < self._next_s:
            return False
        self._left -= 1
        self._next_s = time.monotonic() + self._interval_s
        return True

    @property
    def is_finished(self) -> bool:
        """See `Trigger`."""
        return self._left <= 0


class KeyTrigger:
    """A shot for each key: the space bar or Enter; q, Ctrl-D or the input's end finishes.

    On a terminal single keys are read; from a pipe, lines.
    """

    def __init__(self, stream: TextIO | None = None, shots: int = 0) -> None:
        """``shots`` limits their number; 0: no limit."""
        self._stream = sys.stdin if stream is None else stream
        self._limit, self._asked, self._taken = shots, 0, 0
        self._ended = threading.Event()
        make_supervised_thread("keys", self._read, self._end, self._ended.wait).start()

    def _end(self, reason: str) -> None:  # noqa: ARG002
        """End with what was taken, such as where the terminal is gone."""
        self._ended.set()

    def _read(self) -> None:
        is_terminal = self._stream.isatty()
        while key := read_key(self._stream) if is_terminal else self._stream.readline():
            if key.strip().lower() in ("q", "\x04", "\x03"):
                break
            self._asked += 1
        self._ended.set()

    def is_due(self) -> bool:
        """See `Trigger`."""
        if self._taken >= self._asked or self.is_finished:
            return False
        self._taken += 1
        return True

    @property
    def is_finished(self) -> bool:
        """See `Trigger`."""
        has_all = self._limit > 0 and self._taken >= self._limit
        return has_all or (self._ended.is_set() and self._taken >= self._asked)
