"""Where data enters: live and offline differ only behind this."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from beltscape.core.frames import FrameSet


class FrameSource(Protocol):
    """Gives frame sets in the order of their trigger instants."""

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras it knows."""
        ...

    def __iter__(self) -> Iterator[FrameSet]: ...

    def __len__(self) -> int: ...
