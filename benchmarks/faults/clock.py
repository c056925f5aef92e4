"""A clock of recorded time: the running system's delays then count seconds of the recording."""

from __future__ import annotations

import sys
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

_PACKAGES = ("beltscape.pipeline.live", "beltscape.health", "beltscape.alarms")


@dataclass(slots=True)
class Clock:
    """Recorded time; replaces the monotonic clock of the live system."""

    now_s: float = 0.0

    def monotonic(self) -> float:
        """Return the time in seconds; it begins well above 0, as the system's does."""
        return 1000.0 + self.now_s

    def monotonic_ns(self) -> int:
        """Return the same in nanoseconds."""
        return round(self.monotonic() * 1e9)


@contextmanager
def use_clock(clock: Clock) -> Generator[None]:
    """Use this clock in the live system's modules."""
    replaced: list[tuple[Any, str, Any]] = []
    for name, module in list(sys.modules.items()):
        if not name.startswith(_PACKAGES) or module is None:
            continue
        for function in ("monotonic", "monotonic_ns"):
            if hasattr(module, function):
                replaced.append((module, function, getattr(module, function)))
                setattr(module, function, getattr(clock, function))
    try:
        yield
    finally:
        for module, function, original in replaced:
            setattr(module, function, original)
