"""Frame sets of a moving belt → flow records, one after the other: the same live and offline."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError, ReconstructionError
from beltscape.core.flow import FlowRecord
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Reporter
from beltscape.core.rig import Rig
from beltscape.core.scaling import scale_between
from beltscape.measure.flow.ground import Ground, ground_of
from beltscape.measure.flow.meter import FlowMeter
from beltscape.pipeline.belt import empty_belt
from beltscape.stereo.prior import Prior

_MARGIN = 0.02
"""Depths are looked for a little beyond those of the empty belt."""


@dataclass(frozen=True, slots=True, eq=False)
class Passed:
    """What one frame set gave."""

    depth: DepthMap | None
    """None where it gave none."""
    records: list[FlowRecord]
    """Those that are finished with it."""


class SequenceMatcher(Protocol):
    """What makes depth of one frame after the other."""

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter, *, prior: Prior | None = None) -> DepthMap:
        """Depth of a frame, from the one before it; ReconstructionError where its images do not suffice."""
        ...


class FlowChain:
    """Matcher and meter as one; the matcher starts from the frame before, moved with the belt."""

    def __init__(self, matcher: SequenceMatcher, meter: FlowMeter) -> None:
        self.meter = meter
        self.done = 0
        """Frame sets that gave depth."""
        self.failure: ReconstructionError | None = None
        """Why the last one that gave none did not."""
        self._matcher = matcher
        self._before: DepthMap | None = None

    def push(self, frames: FrameSet, reporter: Reporter, *, whole: bool) -> Passed:
        """The next frame set; one without usable images still tells where the belt was.

        ``whole`` says whether all cameras are in it.
        """
        depth = self._depth(frames, reporter) if frames.images else None
        self._before = depth
        records = self.meter.push(
            depth, frames.time_ns, frames.position_mm, frame=frames.frame, whole=whole or depth is None
        )
        return Passed(depth, records)

    def finish(self) -> list[FlowRecord]:
        """No more frames come: the records that are left."""
        return self.meter.finish()

    def restart(self, meter: FlowMeter) -> None:
        """Measure on with another meter: the belt's count begins anew."""
        self.meter, self._before = meter, None

    def _depth(self, frames: FrameSet, reporter: Reporter) -> DepthMap | None:
        try:
            depth = self._matcher.reconstruct(frames, reporter, prior=self._prior(frames))
        except ReconstructionError as error:
            self.failure = error
            reporter.warn(f"{error}; going on without this frame")
            return None
        self.done += 1
        return depth

    def _prior(self, frames: FrameSet) -> Prior | None:
        if self._before is None:
            return None
        motion = self.meter.expected_motion_mm(frames.time_ns, frames.position_mm)
        return None if motion is None else Prior(self._before, motion)


def ground_under(empty: Path, rig: Rig, cell_mm: float | None, reporter: Reporter) -> Ground:
    """The empty belt as a floor for the rig's depth maps.

    Raises
    ------
    InputError, MeasureError
        When it was reconstructed with another rig, or shows no belt.
    """
    belt, camera = empty_belt(empty, reporter)
    if camera.name != rig.core or scale_between(camera, rig.core_camera) is None:
        raise InputError(
            f"{empty}: reconstructed with another rig; reconstruct the empty belt with the rig.json given here"
        )
    return ground_of(belt, rig.core_camera, cell_mm)


def depths_over(ground: Ground, load_mm: float) -> tuple[float, float]:
    """Near and far end of the depths of a belt that is loaded up to so many mm."""
    near, far = ground.depths_mm()
    return (1 - _MARGIN) * max(near - load_mm, 0.1 * near), (1 + _MARGIN) * far


def reaching(ground: Ground, near_far_mm: tuple[float, float]) -> tuple[float, float]:
    """Depths found in images, widened so that the empty belt is among them."""
    low, high = ground.depths_mm()
    return min(near_far_mm[0], (1 - _MARGIN) * low), max(near_far_mm[1], (1 + _MARGIN) * high)
