"""A plant with drawn images and computed depth maps: the rows of the bench without rendering and matching."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltscape.core.depth import DepthMap
from beltscape.core.errors import ReconstructionError
from beltscape.core.findings import Finding
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.ledger import BeltRecord
from beltscape.core.progress import Reporter, Silent
from beltscape.health.images.monitor import ImageMonitor
from beltscape.health.settings import HealthSettings
from beltscape.measure.belt.empty_belt import find_belt
from beltscape.measure.belt.reference import EmptyBeltReference, make_reference
from beltscape.measure.flow.density import Density
from beltscape.measure.flow.settings import FlowSettings
from beltscape.pipeline.live.ledger import LedgerState
from beltscape.pipeline.live.measurement_run import MeasurementContext, MeasurementRun
from tests.health.images.speckled_belt import make_frame, make_rig
from tests.measure.flow.moving_belt import CAMERA, COARSE_CAMERA, HEIGHT_MM, Heap, depth_map

Array = NDArray[np.float64]
FRAMES, STEP_MM = 20, 93.0
ROUND_MM = FRAMES * STEP_MM
LEARNING = 8


@dataclass(frozen=True, eq=False)
class Heaps(Heap):
    """A heap of 1.3 m that comes again every round."""

    start_mm: float = -1660.0
    end_mm: float = -360.0

    def height_mm(self, x: Array, y: Array) -> Array:
        return super().height_mm(x, y % ROUND_MM - ROUND_MM)


HEAPS = Heaps()


class DrawnCapture:
    """A round of the plant, as the bench's `RoundCapture`."""

    frames, round_mm, folder = FRAMES, ROUND_MM, Path()
    scenario = SimpleNamespace(rig=SimpleNamespace(height_mm=HEIGHT_MM))

    @cached_property
    def rig(self) -> Rig:
        return make_rig()

    @cached_property
    def area(self) -> tuple[Array, Array]:
        """Return the belt's own y, mm, and the cross-section there, mm²."""
        x, y = np.arange(-149.5, 150.0), np.arange(0.5 - ROUND_MM, 0.0)
        return y, HEAPS.height_mm(x[None], y[:, None]).sum(axis=1)

    def position_mm(self, frame: int) -> float:
        return frame * STEP_MM

    def images(self, frame: int) -> FrameSet:
        return make_frame(frame)


class DrawnMatcher:
    """Checks the images as the running system does, and returns the depth map of the belt at a frame."""

    is_inconsistent = False

    def __init__(self, rig: Rig) -> None:
        self._monitor = ImageMonitor(rig, HealthSettings(learning_frames=LEARNING))
        self.findings: tuple[Finding, ...] = ()

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter) -> DepthMap:
        check = self._monitor.check_images(frame_set)
        self.findings = check.findings
        if not check.frames.images:
            raise ReconstructionError("nothing to match")
        return depth_map(HEAPS, int(frame_set.frame) * STEP_MM % ROUND_MM, seed=7, camera=COARSE_CAMERA)


def make_empty_belt(rise_mm: float) -> EmptyBeltReference:
    """Return the empty belt as it was learned: lower by ``rise_mm`` than it is now."""
    empty = depth_map(None, 0.0, seed=99)
    lower = replace(empty, depth_mm=empty.depth_mm + np.float32(rise_mm))
    return make_reference(find_belt(lower, CAMERA), COARSE_CAMERA)


def play_drawn(make_feed: Callable[..., Any], played: Any, *, rise_mm: float = 0.0) -> Any:
    """Play a row: fill the bench's `Played` with records and findings and return it."""
    capture = DrawnCapture()
    context = MeasurementContext(
        capture.rig,
        make_empty_belt(rise_mm),
        DrawnMatcher(capture.rig),
        FlowSettings(direction="+y"),
        Density.constant(1500.0),
    )
    run = MeasurementRun(context, LedgerState(1, 0, None), tuple(capture.rig.cameras), lambda: 17, Silent())
    now_s = 0.0

    def note(outcome: Any) -> None:
        entries: list[BeltRecord] = outcome.entries
        played.records += [(now_s, entry) for entry in entries]
        for one in outcome.findings:
            if one.is_fault:
                played.findings.setdefault(f"{one.check}:{one.subject}".rstrip(":"), (now_s, one.text))

    for frames in make_feed(capture, played.case, played.onset, played.count):
        now_s = frames.time_ns * 1e-9
        note(run.push(frames))
        note(run.flush())
    note(run.finish())
    return played
