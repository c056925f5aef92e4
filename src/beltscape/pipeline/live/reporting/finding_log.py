"""The findings on their way to the historian: about one a second and check, and every change of a fault."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Sequence
from time import monotonic, time_ns

from beltscape.core.errors import BeltscapeError
from beltscape.core.live.findings import Finding
from beltscape.sinks.historian import Historian, StoredFinding

_PERIOD_S = 1.0
"""Shortest time between two stored findings of a check without a change of its fault."""
_LONGEST_S = 10.0
"""A finding that has hardly changed is stored after this time."""
_SIGMAS = 0.5
"""A change by less than this share of σ is none; the noise of most checks exceeds it."""
_CAPACITY = 20_000
"""Most waiting findings; beyond it the oldest are lost, which bounds the memory while the disk fails."""


class FindingLog:
    """Selects the findings that are stored, on the worker's thread; stores them on another."""

    def __init__(
        self, monotonic_s: Callable[[], float] = monotonic, wall_ns: Callable[[], int] = time_ns
    ) -> None:
        self._monotonic_s, self._wall_ns = monotonic_s, wall_ns
        self._last: dict[tuple[str, str], tuple[float, Finding]] = {}
        self._waiting: deque[StoredFinding] = deque(maxlen=_CAPACITY)
        self._lock = threading.Lock()

    def put(self, findings: Sequence[Finding]) -> None:
        """Add the findings of one frame set; returns at once."""
        now_s, wall_ns = self._monotonic_s(), self._wall_ns()
        with self._lock:
            for finding in findings:
                key = (finding.check, finding.subject)
                last = self._last.get(key)
                if last is None or _is_due(finding, last[1], now_s - last[0]):
                    self._last[key] = now_s, finding
                    self._waiting.append(StoredFinding(wall_ns, finding))

    def store(self, historian: Historian) -> None:
        """Store the waiting findings; those that the disk refuses wait for the next call."""
        with self._lock:
            waiting = list(self._waiting)
            self._waiting.clear()
        try:
            historian.add_findings(waiting)
        except BeltscapeError:  # the historian's own trouble is an alarm
            with self._lock:
                self._waiting.extendleft(reversed(waiting[-_CAPACITY + len(self._waiting) :]))


def _is_due(finding: Finding, last: Finding, elapsed_s: float) -> bool:
    """Return whether a finding is stored that follows ``last`` after ``elapsed_s``."""
    if (finding.is_fault, finding.effect, finding.cause) != (last.is_fault, last.effect, last.cause):
        return True
    if elapsed_s < _PERIOD_S:
        return False
    if elapsed_s >= _LONGEST_S or math.isfinite(finding.value) != math.isfinite(last.value):
        return True
    return not abs(finding.value - last.value) <= _SIGMAS * finding.sigma
