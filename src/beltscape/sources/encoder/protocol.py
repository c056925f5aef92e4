"""The interface of all encoders."""

from __future__ import annotations

from typing import Protocol


class Encoder(Protocol):
    """Source of the belt's position; usable from any thread."""

    def position_at(self, time_ns: int | None, frame: str) -> float | None:
        """Return the position (mm) at a frame's monotonic time; None: no reading near it."""
        ...

    @property
    def silent_s(self) -> float:
        """Seconds since the last reading, or since opening; NaN for encoders that cannot fall silent."""
        ...

    @property
    def trouble(self) -> str:
        """The fault of its readings, and the fix, in one line; empty without a fault."""
        ...

    def close(self) -> None:
        """Stop receiving readings."""
        ...
