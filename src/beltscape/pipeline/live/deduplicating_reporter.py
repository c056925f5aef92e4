"""Warnings of a running system: each is told once, and again only after a while."""

from __future__ import annotations

import re
import threading
from collections import OrderedDict
from time import monotonic

from beltscape.core.live import Observer

_AGAIN_S = 300.0
_KEPT = 500


class Noting:
    """A ``Reporter`` for an observer; messages that differ only in numbers count as the same."""

    def __init__(self, observer: Observer, again_s: float = _AGAIN_S) -> None:
        """``again_s``: so long the same message is not repeated."""
        self._observer, self._again_s = observer, again_s
        self._told: OrderedDict[str, float] = OrderedDict()
        self._lock = threading.Lock()

    def step(self, stage: str, done: int, total: int) -> None:
        """A running system has no end to come nearer to."""

    def warn(self, message: str) -> None:
        """Pass it on, unless the same was said a short while ago."""
        kind, now = re.sub(r"\d+", "#", message), monotonic()
        with self._lock:
            if now - self._told.get(kind, float("-inf")) < self._again_s:
                return
            self._told[kind] = now
            self._told.move_to_end(kind)
            while len(self._told) > _KEPT:
                self._told.popitem(last=False)
        self._observer.on_message(message)
