"""Frame sets of a moving belt → flow records, one after the other: the same live and offline."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from beltscape.core.belt.flow_record import FlowRecord
from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError, ReconstructionError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Reporter
from beltscape.core.rig import Rig
from beltscape.core.scaling import pinhole_scale
from beltscape.measure.flow.fusion.empty_belt_reference import Ground, ground_of
from beltscape.measure.flow.meter import FlowMeter
from beltscape.measure.flow.motion.prediction import Foresight
from beltscape.pipeline.measuring.belt import read_empty_belt
from beltscape.stereo.multiview.initialisation.temporal_prior import Prior

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

    @property
    def is_inconsistent(self) -> bool:
        """Whether cameras contradict the rig: the belt of such frames counts as degraded."""
        ...

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter, *, prior: Prior | None = None) -> DepthMap:
        """Depth of a frame, from the one before it; ReconstructionError where its images do not suffice."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class _Matched:
    """A frame that is matched, and not measured yet."""

    frame: str
    time_ns: int | None
    position_mm: float | None
    depth: DepthMap | None
    whole: bool
    foresight: Foresight | None
    """How the belt should move on, by what was measured before this frame."""


class FlowChain:
    """Matcher and meter as one: while a frame is matched, the one before it is measured.

    The matcher starts from the frame before, moved with the belt. Neither which thread is faster nor `flush` changes
    a result: how the belt should have moved is told by what was measured before the frame before.
    """

    def __init__(self, matcher: SequenceMatcher, meter: FlowMeter) -> None:
        self.meter = meter
        self.done = 0
        """Frame sets that gave depth."""
        self.failure: ReconstructionError | None = None
        """Why the last one that gave none did not."""
        self._matcher = matcher
        self._matching = ThreadPoolExecutor(1, "matcher")
        self._before: _Matched | None = None
        self._waiting: _Matched | None = None
        """The same where it is not measured yet."""

    def push(self, frames: FrameSet, reporter: Reporter, *, whole: bool) -> Passed:
        """The next frame set; one without usable images still tells where the belt was.

        ``whole`` says whether all cameras are in it. The records are those of the frame before.
        """
        found = self._matching.submit(self._depth, frames, self._prior(frames), reporter)
        try:
            records = self.flush()
        finally:
            depth = found.result()
        self._before = self._waiting = _Matched(
            frames.frame,
            frames.time_ns,
            frames.position_mm,
            depth,
            (whole and not self._matcher.is_inconsistent) or depth is None,
            self.meter.foresight,
        )
        return Passed(depth, records)

    def flush(self) -> list[FlowRecord]:
        """Measure the frame before without waiting for the next one, where there is time."""
        one, self._waiting = self._waiting, None
        if one is None:
            return []
        return self.meter.push(one.depth, one.time_ns, one.position_mm, frame=one.frame, whole=one.whole)

    def finish(self) -> list[FlowRecord]:
        """No more frames come: the records that are left."""
        return self.flush() + self.meter.finish()

    def restart(self, meter: FlowMeter) -> None:
        """Measure on with another meter, after `finish`: the belt's count begins anew."""
        self.meter, self._before = meter, None

    def _depth(self, frames: FrameSet, prior: Prior | None, reporter: Reporter) -> DepthMap | None:
        if not frames.images:
            return None
        try:
            depth = self._matcher.reconstruct(frames, reporter, prior=prior)
        except ReconstructionError as error:
            self.failure = error
            reporter.warn(f"{error}; going on without this frame")
            return None
        self.done += 1
        return depth

    def _prior(self, frames: FrameSet) -> Prior | None:
        """The frame before, and how the belt should have moved since."""
        before = self._before
        if before is None or before.depth is None or before.foresight is None:
            return None
        clock, step = 1.0, None
        if frames.time_ns is not None and before.time_ns is not None:
            clock = (frames.time_ns - before.time_ns) * 1e-9
        if frames.position_mm is not None and before.position_mm is not None:
            step = frames.position_mm - before.position_mm
        motion = before.foresight.motion_mm(clock, step)
        return None if motion is None else Prior(before.depth, motion)


def read_reference(empty: Path, rig: Rig, cell_mm: float | None, reporter: Reporter) -> Ground:
    """The empty belt as a floor for the rig's depth maps.

    Raises
    ------
    InputError, MeasureError
        When it was reconstructed with another rig, or shows no belt.
    """
    belt, camera = read_empty_belt(empty, reporter)
    if camera.name != rig.core or pinhole_scale(camera, rig.core_camera) is None:
        raise InputError(
            f"{empty}: reconstructed with another rig; reconstruct the empty belt with the rig.json given here"
        )
    return ground_of(belt, rig.core_camera, cell_mm)


def depth_range_over(ground: Ground, load_mm: float) -> tuple[float, float]:
    """Near and far end of the depths of a belt that is loaded up to so many mm."""
    near, far = ground.depths_mm()
    return (1 - _MARGIN) * max(near - load_mm, 0.1 * near), (1 + _MARGIN) * far


def widen_to_belt(ground: Ground, near_far_mm: tuple[float, float]) -> tuple[float, float]:
    """Depths found in images, add_systematic_error so that the empty belt is among them."""
    low, high = ground.depths_mm()
    return min(near_far_mm[0], (1 - _MARGIN) * low), max(near_far_mm[1], (1 + _MARGIN) * high)
