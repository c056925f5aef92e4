"""A frame that is matched elsewhere, on a thread or a worker, while this process does something else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Reporter
from beltscape.pipeline.reconstructing.frame_measurements import MeasuredDepth, MeasurementRequest


class FrameMatcher(Protocol):
    """Reconstructs frames; a frame's depth depends on its images only."""

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter) -> DepthMap:
        """Return the depth of a frame; ReconstructionError if its images do not suffice."""
        ...


class PendingDepth(Protocol):
    """The depth of a frame that is being matched elsewhere."""

    def result(self) -> MeasuredDepth | None:
        """Wait for the depth and return it; None if it could not be matched there. Errors as `FrameMatcher`."""
        ...

    def done(self) -> bool:
        """Return whether `result` need not wait."""
        ...


class MatchPool(Protocol):
    """Threads or workers that match frames."""

    def submit(
        self,
        frame_set: FrameSet,
        auxiliaries: tuple[str, ...],
        make_matcher: Callable[[], FrameMatcher],
        request: MeasurementRequest | None = None,
    ) -> PendingDepth:
        """Begin to match a frame with the matcher of these auxiliaries; a pool may measure what is requested.

        Raises
        ------
        ReconstructionError
            When there can be no such matcher.
        """
        ...


@dataclass(slots=True, eq=False)
class PendingMatch:
    """A frame that is being matched on another thread or worker."""

    auxiliaries: tuple[str, ...]
    """The auxiliaries used for the depth."""
    depth: PendingDepth
    request: MeasurementRequest | None = None
    """What was requested beside the depth."""
    measured: MeasuredDepth | None = None
    """What `wait` returned."""

    def wait(self) -> MeasuredDepth | None:
        """Wait for the depth and return it; None if it could not be matched there. Errors as `FrameMatcher`."""
        self.measured = self.depth.result()
        return self.measured
