"""The interface of frame sources, which recorded captures and live cameras implement."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from beltscape.core.frames import FrameSet


class FrameSource(Protocol):
    """Source of frame sets in the order of their trigger instants."""

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of its cameras."""
        ...

    def __iter__(self) -> Iterator[FrameSet]: ...

    def __len__(self) -> int: ...
