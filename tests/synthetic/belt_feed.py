"""A belt that runs past a fake matcher: what a run counts is held against what the encoder said."""

from __future__ import annotations

from functools import cache

import numpy as np
from flow.moving_belt import CAMERA, Heap, depth_map, ground

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet
from beltscape.core.pose import Pose
from beltscape.core.progress import Reporter, Silent
from beltscape.core.rig import Rig
from beltscape.measure.flow.fusion.empty_belt_reference import Ground
from beltscape.measure.flow.records.density import Density
from beltscape.measure.flow.settings import FlowSettings
from beltscape.pipeline.live.ledger import LedgerState
from beltscape.pipeline.live.measurement_run import MeasurementContext, MeasurementRun
from beltscape.stereo.multiview.initialisation.temporal_prior import Prior

HEAP = Heap(start_mm=-2600, end_mm=-450)
CAMERAS = ("cam0", "cam1")
RIG = Rig("cam0", {"cam0": CAMERA, "cam1": CAMERA}, {name: Pose.identity() for name in CAMERAS})
IMAGE = np.zeros(CAMERA.size_px[::-1], np.uint8)


@cache
def floor() -> Ground:
    return ground()


@cache
def seen(place_mm: float) -> DepthMap:
    return depth_map(HEAP, place_mm)


class FakeMatcher:
    """Knows where the belt is from the frame's name."""

    is_inconsistent = False

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter, *, prior: Prior | None = None) -> DepthMap:
        return seen(float(frame_set.frame))


def bench() -> MeasurementContext:
    return MeasurementContext(RIG, floor(), FakeMatcher(), FlowSettings(direction="+y"), Density.constant(1500.0))


def frames(place_mm: float, position_mm: float | None, *, cameras: tuple[str, ...] = CAMERAS) -> FrameSet:
    """A frame set taken when the belt had moved so far at 1 m/s; ``position_mm`` is what the encoder says."""
    return FrameSet(f"{place_mm}", dict.fromkeys(cameras, IMAGE), round(place_mm * 1e6), position_mm)


def run(state: LedgerState) -> MeasurementRun:
    return MeasurementRun(bench(), state, CAMERAS, lambda: 17, Silent())
