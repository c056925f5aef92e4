"""What every encoder can be asked."""

from __future__ import annotations

from typing import Protocol


class Encoder(Protocol):
    """Tells where the belt was, from any thread."""

    def at(self, time_ns: int | None, frame: str) -> float | None:
        """Position (mm) at a frame's steady time; None: silent then, or before the first reading."""
        ...

    @property
    def silent_s(self) -> float:
        """Seconds since the last reading, or since it was opened; NaN for one that cannot be silent."""
        ...

    @property
    def trouble(self) -> str:
        """What is wrong with what it says, and the mend, in one line; empty: nothing."""
        ...

    def close(self) -> None:
        """Stop listening."""
        ...
