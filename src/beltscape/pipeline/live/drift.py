"""Drift of the rig while the system runs: tie points of ordinary frames are summed, and compared with the first ones.

Nothing is changed by it. An engineer reads the estimates (`beltscape drift`) and takes a proposal or not.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from time import monotonic, time_ns
from typing import Any

import numpy as np

from beltscape.core.errors import BeltscapeError
from beltscape.core.geometry.rig import Rig
from beltscape.sinks.historian import Historian
from beltscape.stereo.consistency.drift import (
    Drift,
    DriftAccumulator,
    DriftWindow,
    estimate_drift,
    read_window,
)
from beltscape.stereo.consistency.tie_points import TiePoints

_MOST_WAITING = 24
"""Windows that wait while the history cannot be written; older ones are lost."""


class DriftMonitor:
    """Sums tie points of sound frames on the worker's thread; estimates and stores on another."""

    def __init__(
        self,
        rig: Rig,
        digest: str,
        *,
        every_s: float,
        frames: int,
        monotonic_s: Callable[[], float] = monotonic,
        wall_ns: Callable[[], int] = time_ns,
    ) -> None:
        """``digest`` is the SHA-256 of the rig's file, ``every_s`` the time between two of a window's ``frames``."""
        self._rig, self._digest = rig, digest
        self._every_s, self._frames = every_s, frames
        self._monotonic_s, self._wall_ns = monotonic_s, wall_ns
        self._accumulator: DriftAccumulator | None = None
        self._last_s = float("-inf")
        self._waiting: deque[tuple[int, DriftWindow]] = deque(maxlen=_MOST_WAITING)
        self._lock = threading.Lock()

    def add(self, tie_points: TiePoints) -> None:
        """Add the tie points of a sound frame, if one is due."""
        now_s = self._monotonic_s()
        if now_s - self._last_s < self._every_s or len(self._rig.cameras) < 2:
            return
        self._last_s = now_s
        self._accumulator = self._accumulator or DriftAccumulator(self._rig)
        self._accumulator.add(tie_points)
        if self._accumulator.frames >= self._frames:
            with self._lock:
                self._waiting.append((self._wall_ns(), self._accumulator.close()))

    def store(self, historian: Historian) -> None:
        """Estimate and store what the finished windows show; those that the disk refuses wait for the next call."""
        while self._waiting:
            wall_ns, window = self._waiting[0]
            try:
                first = historian.read_first_drift(self._digest)
                reference = None if first is None else first.document
                historian.add_drift(wall_ns, self._digest, describe_window(window, reference, self._rig))
            except BeltscapeError:  # the historian's own trouble is an alarm
                return
            with self._lock, suppress(IndexError):
                self._waiting.popleft()


def store_drift(monitor: DriftMonitor | None, historian: Historian) -> None:
    """Store what a monitor has found; nothing without one."""
    if monitor is not None:
        monitor.store(historian)


def describe_window(window: DriftWindow, reference: Mapping[str, Any] | None, rig: Rig) -> dict[str, Any]:
    """Return the document of a window: its drift since the reference, the first one where that is None."""
    document: dict[str, Any] = {"window": window.to_document()}
    if reference is None:
        return document
    return {**document, **describe_drift(estimate_drift(window, read_window(reference["window"]), rig))}


def describe_drift(drift: Drift) -> dict[str, Any]:
    """Return a drift as plain values."""
    return {
        "moved": drift.moved,
        "cameras": list(drift.cameras),
        "change": drift.change.tolist(),
        "covariance": [[float(f"{one:.5g}") for one in row] for row in drift.covariance],
        "row_px": {name: [_finite(one) for one in value] for name, value in drift.row_px.items()},
        "chi_square": drift.chi_square,
        "left": drift.left,
        "medians": drift.medians,
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
