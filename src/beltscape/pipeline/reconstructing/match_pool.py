"""Threads or workers that match frames beside the process that checks them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Reporter


class FrameMatcher(Protocol):
    """Reconstructs frames; a frame's depth depends on its images only."""

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter) -> DepthMap:
        """Return the depth of a frame; ReconstructionError if its images do not suffice."""
        ...


class PendingDepth(Protocol):
    """The depth of a frame that is being matched elsewhere."""

    def result(self) -> DepthMap | None:
        """Wait for the depth and return it; None if it could not be matched there. Errors as `FrameMatcher`."""
        ...


class MatchPool(Protocol):
    """Threads or workers that match frames."""

    def submit(
        self, frame_set: FrameSet, auxiliaries: tuple[str, ...], make_matcher: Callable[[], FrameMatcher]
    ) -> PendingDepth:
        """Begin to match a frame with the matcher of these auxiliaries.

        Raises
        ------
        ReconstructionError
            When there can be no such matcher.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class PendingMatch:
    """A frame that is being matched on another thread or worker."""

    auxiliaries: tuple[str, ...]
    """The auxiliaries used for the depth."""
    depth: PendingDepth
