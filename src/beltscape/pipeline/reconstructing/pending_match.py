"""A frame that is matched elsewhere, on a thread or a worker, while this process does something else."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from beltscape.core.depth import DepthMap
from beltscape.core.errors import ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Reporter
from beltscape.health.image_statistics import ImageSample
from beltscape.pipeline.reconstructing.frame_measurements import (
    CamerasAhead,
    FrameMeasurements,
    MeasuredDepth,
    MeasurementRequest,
)


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
    _has_ended: bool = False

    def wait(self) -> MeasuredDepth | None:
        """Wait for the depth and return it; None if it could not be matched there. Errors as `FrameMatcher`."""
        if not self._has_ended:
            self.measured = self.depth.result()
            self._has_ended = True
        return self.measured

    def find_images(self) -> Mapping[str, ImageSample] | None:
        """Wait for the match and return what the checks take from the images; None: it is not known."""
        try:
            measured = self.wait()
        except ReconstructionError:
            return None
        if measured is None or measured.measurements is None:
            return None
        return measured.measurements.images

    def find_measurements(
        self, depth: DepthMap | None
    ) -> tuple[MeasurementRequest, FrameMeasurements] | None:
        """Return what was measured of the frame with this depth, and the request; None: nothing.

        It holds for the very depth that `wait` returned: another one has an error added, or other cameras.
        """
        measured = self.measured
        if self.request is None or measured is None or measured.measurements is None:
            return None
        return (self.request, measured.measurements) if measured.depth is depth else None

    def find_cameras(self, depth: DepthMap) -> CamerasAhead | None:
        """Return the check of the cameras with this depth; None: there is none."""
        request, measurements = self.find_measurements(depth) or (None, None)
        if request is None or measurements is None or request.cameras is None or measurements.cameras is None:
            return None
        return CamerasAhead(request.cameras.value, measurements.cameras)
