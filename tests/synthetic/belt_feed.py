"""A moving belt in front of a fake matcher, to compare the measured totals with the encoder."""

from __future__ import annotations

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter, Silent
from beltscape.measure.flow.density import Density
from beltscape.measure.flow.settings import FlowSettings
from beltscape.pipeline.live.ledger import LedgerState
from beltscape.pipeline.live.measurement_run import MeasurementContext, MeasurementRun
from tests.measure.flow.moving_belt import COARSE_CAMERA, Heap, depth_map, make_empty_belt

HEAP = Heap(start_mm=-2600, end_mm=-450)
CAMERA = COARSE_CAMERA
CAMERAS = ("cam0", "cam1")
RIG = Rig("cam0", {"cam0": CAMERA, "cam1": CAMERA}, {name: Pose.identity() for name in CAMERAS})
IMAGE = np.zeros(CAMERA.size_px[::-1], np.uint8)


class FakeMatcher:
    """Returns the depth map of the belt position that the frame's name contains."""

    is_inconsistent = False
    findings = ()

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter) -> DepthMap:
        return depth_map(HEAP, float(frame_set.frame), camera=CAMERA)


def make_context(camera: Camera = CAMERA) -> MeasurementContext:
    return MeasurementContext(
        RIG,
        make_empty_belt(camera),
        FakeMatcher(),
        FlowSettings(direction="+y"),
        Density.constant(1500.0),
    )


def frames(place_mm: float, position_mm: float | None, *, cameras: tuple[str, ...] = CAMERAS) -> FrameSet:
    """Return a frame set taken after ``place_mm`` of travel at 1 m/s; ``position_mm`` is the encoder's value."""
    return FrameSet(f"{place_mm}", dict.fromkeys(cameras, IMAGE), round(place_mm * 1e6), position_mm)


def run(state: LedgerState) -> MeasurementRun:
    return MeasurementRun(make_context(), state, CAMERAS, lambda: 17, Silent())
